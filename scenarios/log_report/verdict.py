"""What scores on recorded logs do and do not show, in words."""

import math
from typing import NamedTuple

import numpy as np

from estimators.evaluation.logs import KNOWN, LEVEL, RAW, LogScores

CLEAR = 0.8
"""An estimator whose error is above this share of a level guess's has shown little."""
LARGE_BIAS = math.radians(1.0)
"""Gyroscope bias that estimators have to find [rad/s]."""
GAINED = 0.5
"""Share of the error, after the bias is removed, below which the bias is named as its cause."""


class LogVerdict(NamedTuple):
    """The answer, and its conditions."""

    headline: str
    lines: list[str]


def log_verdict(scores: LogScores) -> LogVerdict:
    """Which estimator had the smallest error, how a level guess compares, and what limits the finding."""
    unranked = scores.unranked
    notes = [f"{name} {reason.rstrip('.')}: it is not ranked." for name, reason in unranked.items()]
    compared = [line for log in scores.comparisons for line in _compared(scores, log)]
    if not scores.scored:
        favoured = {log: found.favoured for log, found in scores.comparisons.items()}
        favours = dict.fromkeys(favoured.values())
        choice = ", ".join(next(iter(favours))) if len(favours) == 1 else ""
        evidence = f"the mean force favours {choice}" if choice else "the evidence favours no estimator"
        if len(favours) > 1:
            evidence = "the evidence differs from log to log"
        headline = f"No true attitude, no errors; {evidence}."
        return LogVerdict(headline, [*compared, *_believed(scores), *notes])
    logs, names = scores.scored, [n for n in scores.estimators if n != LEVEL and n not in unranked]
    error = {name: scores.mean(name, RAW) for name in scores.estimators}
    seconds = sum(int(scores.counted[log].sum()) / _rate(scores, log) for log in logs)
    data = f"{len(logs)} log{'s' if len(logs) > 1 else ''}, {seconds:.0f} s scored"
    if not names:
        return LogVerdict("No estimator is ranked.", [*compared, *notes])
    best, level = names[0], error[LEVEL]
    headline = f"Smallest error: {best}, {error[best]:.2f}° inclination RMSE."
    if error[best] > CLEAR * level:
        headline = f"No estimator is much better than a level guess ({level:.2f}°)"
        headline += f"; the best is {best}, {error[best]:.2f}°."
    conditions = "from an unknown attitude, with the gyroscope as it reads"
    lines = [f"{data}, {conditions}. A level guess makes {level:.2f}°."]
    lines += [*_by_log(scores, logs, names, best), *_bias(scores, names, error), *_believed(scores)]
    lines += compared
    if len(logs) == 1:
        lines.append("One log shows what happened on it, not which estimator is best on the next.")
    return LogVerdict(headline, lines + notes)


def _rate(scores: LogScores, log: str) -> float:
    return 1.0 / float(np.median(np.diff(scores.time_s[log])))


def _by_log(scores: LogScores, logs: list[str], names: list[str], best: str) -> list[str]:
    """On how many logs the best is the best, and where it is furthest behind."""
    on = {(row.estimator, row.log): row.inclination_rmse_deg for row in scores.rows if row.bias == RAW}
    if len(logs) < 2:
        return []
    least = {log: min((on[name, log], name) for name in names) for log in logs}
    first = sum(least[log][1] == best for log in logs)
    worst = max(logs, key=lambda log: on[best, log] / least[log][0])
    text = f"{best} has the smallest error on {first} of {len(logs)} logs"
    if first < len(logs):
        value, name = least[worst]
        text += f"; it is furthest behind on {worst}: {on[best, worst]:.2f}° where {name} makes {value:.2f}°"
    return [text + "."]


def _bias(scores: LogScores, names: list[str], error: dict[str, float]) -> list[str]:
    """Estimators that lose by a gyroscope bias that they do not find."""
    removed = np.abs([bias for bias in scores.bias_removed.values() if np.isfinite(bias).all()])
    if not removed.any():
        known = removed.size > 0
        text = "No gyroscope bias differs significantly from zero: nothing is removed."
        return [text] if known else []
    largest = float(removed.max())
    if largest < LARGE_BIAS:
        return []
    without = {name: scores.mean(name, KNOWN) for name in names}
    losing = [name for name in names if without[name] < GAINED * error[name]]
    text = f"The gyroscope reads up to {math.degrees(largest):.1f} °/s at rest"
    if losing:
        shown = ", ".join(f"{name} ({error[name]:.1f}°, without it {without[name]:.1f}°)" for name in losing)
        text += (
            f", which these estimators do not find in time: {shown}. Calibrate it: `quadsim logs calibrate`"
        )
    return [text + "."]


def _compared(scores: LogScores, log: str) -> list[str]:
    """How far estimators are apart on a log without truth, and what its forces favour."""
    found = scores.comparisons[log]
    median, most = found.overall
    lines = []
    if found.apart:
        lines.append(
            f"{log} has no true attitude: the inclinations of two estimators differ by {median:.1f}° in the "
            f"median and by {most:.1f}° in the 95th percentile (median over pairs)."
        )
    low, high = min(found.force.values()), max(found.force.values())
    text = f"{log}: turned to the world and averaged over 10 s, the horizontal force is {low:.2f} m/s²"
    text += f" to {high:.2f} m/s² (RMS), and it is near zero for a right attitude: "
    chosen = ", ".join(found.favoured)
    lines.append(text + (f"it favours {chosen}." if chosen else "it favours no estimator significantly."))
    return lines


def _believed(scores: LogScores) -> list[str]:
    """Which models an estimator of several believed, over all logs, and how honest its sigma was."""
    lines = []
    for name in dict.fromkeys(name for _, name in scores.beliefs):
        found = {log: each for (log, whose), each in scores.beliefs.items() if whose == name}
        shares = [each.share() for each in found.values()]
        mean = {model: float(np.mean([share[model] for share in shares])) for model in shares[0]}
        ranked = sorted(mean.items(), key=lambda each: -each[1])
        covered = [
            each.coverage(scores.truth[log][None], scores.counted[log][None])
            for log, each in found.items()
            if log in scores.scored
        ]
        shown = ", ".join(f"{model} {share:.0%}" for model, share in ranked)
        if covered:
            inside = f"{np.nanmean(covered):.0%} of the true angles are in its 95 % interval"
        else:
            inside = f"its σ is {np.median([each.sigma_deg for each in found.values()]):.1f}° in the median"
        lines.append(f"{name} believed, in share of the time: {shown}; {inside}.")
    return lines
