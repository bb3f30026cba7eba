"""What scores on recorded logs do and do not show, in words."""

import math
from typing import NamedTuple

import numpy as np

from estimators.evaluation.beliefs import Interval
from estimators.evaluation.logs import KNOWN, LEVEL, RAW, LogScores

CLEAR = 0.8
"""An estimator whose error is above this share of a level guess's has shown little."""
LARGE_BIAS = math.radians(1.0)
"""Gyroscope bias that estimators have to find [rad/s]."""
GAINED = 0.5
"""Share of the error, after the bias is removed, below which the bias is named as its cause."""


ADVICE = {
    "bias jump": "Calibration does not cure a bias that jumps: look at the sensor's supply, temperature and "
    "mount, replace it if the jump returns, and fly on an estimator that tracks the bias.",
    "stuck axis": "Calibration does not cure an axis that sticks: look at the bus and its driver.",
    "saturation": "A saturated axis needs a wider range of the sensor, or gentler motion.",
    "vibration": "Vibration that sets in is mechanical: look at propellers, bearings and the IMU's mount.",
}
"""Kind of fault to what its user is to do."""


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
        sound = [log for log in scores.comparisons if not scores.faults.get(log)] or [*scores.comparisons]
        found = dict.fromkeys(
            (scores.comparisons[log].favoured, scores.comparisons[log].undecided) for log in sound
        )
        favoured, undecided = next(iter(found))
        choice = ", ".join(favoured)
        evidence = (
            f"the mean force favours {choice}"
            if choice
            else f"the evidence favours no estimator: {undecided}"
        )
        if len(found) > 1:
            evidence = "the evidence differs from log to log"
        over = ", over the logs without a fault" if len(sound) < len(scores.comparisons) else ""
        headline = f"No true attitude, no errors; {evidence}{over}."
        return LogVerdict(headline, [*compared, *_failing(scores), *_believed(scores), *notes])
    logs, names = scores.headline, [n for n in scores.estimators if n != LEVEL and n not in unranked]
    error = {name: scores.mean(name, RAW) for name in scores.estimators}
    seconds = sum(int(scores.counted[log].sum()) / _rate(scores, log) for log in logs)
    data = f"{len(logs)} log{'s' if len(logs) > 1 else ''}, {seconds:.0f} s scored"
    if not names:
        return LogVerdict("No estimator is ranked.", [*compared, *notes])
    best, level = names[0], error[LEVEL]
    over = ", over the logs without a fault" if scores.faulty else ""
    if scores.headline == scores.faulty:
        over = f", but {'the log has' if len(logs) == 1 else 'all logs have'} a fault of a sensor"
    headline = f"Smallest error: {best}, {error[best]:.2f}° inclination RMSE{over}."
    if error[best] > CLEAR * level:
        headline = f"No estimator is much better than a level guess ({level:.2f}°){over}"
        headline += f"; the best is {best}, {error[best]:.2f}°."
    conditions = "from an unknown attitude, with the gyroscope as it reads"
    lines = [
        f"{data}, {conditions}. A level guess makes {level:.2f}°.",
        *([scores.tuning] if scores.tuning else []),
    ]
    lines += [*_failing(scores), *_by_log(scores, logs, names, best)]
    lines += [*_bias(scores, names, error), *_believed(scores), *compared]
    if len(logs) == 1:
        lines.append("One log shows what happened on it, not which estimator is best on the next.")
    return LogVerdict(headline, lines + notes)


def _rate(scores: LogScores, log: str) -> float:
    return 1.0 / float(np.median(np.diff(scores.time_s[log])))


def _failing(scores: LogScores) -> list[str]:
    """Logs in which a fault begins, apart from the others, and what their user is to do."""
    lines, faulty = [], scores.faulty
    if faulty and scores.headline == faulty:
        where = "the log" if len(faulty) == 1 else "every log"
        lines.append(f"A fault of a sensor begins in {where}: no error here is that of a sound sensor.")
    elif faulty:
        count = f"{len(faulty)} of {len(scores.scored)} logs {'has' if len(faulty) == 1 else 'have'}"
        lines.append(f"{count} a fault of a sensor: means and headline are without {', '.join(faulty)}.")
    ranked = [name for name in scores.estimators if name != LEVEL and name not in scores.unranked]
    for log, faults in scores.faults.items():
        if not faults:
            continue
        text = f"{log}, {'; '.join(fault.sentence for fault in faults)}."
        on = {name: scores.on_log(log, name, RAW) for name in ranked}
        if errors := {name: error for name, error in on.items() if math.isfinite(error)}:
            best = min(errors, key=lambda name: errors[name])
            text += f" The smallest error on it is {errors[best]:.2f}° ({best})."
        lines.append(text)
    kinds = {fault.kind for faults in scores.faults.values() for fault in faults}
    return lines + [ADVICE[kind] for kind in ADVICE if kind in kinds]


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
    failing = {log for log, faults in scores.faults.items() if any(f.sensor == "gyroscope" for f in faults)}
    biases = [bias for log, bias in scores.bias_removed.items() if log in set(scores.headline) - failing]
    removed = np.abs([bias for bias in biases if np.isfinite(bias).all()])
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
            f", which these estimators do not find in time: {shown}. Calibrate it: `quadsim identify --still`"
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
    text += f" to {high:.2f} m/s² (RMS), of a level guess {found.level_force:.2f} m/s². "
    text += "It is near zero for a right attitude, and for a level guess where the vehicle stays level: "
    chosen = ", ".join(found.favoured)
    lines.append(
        text + (f"it favours {chosen}." if chosen else f"it favours no estimator: {found.undecided}.")
    )
    return lines


def _believed(scores: LogScores) -> list[str]:
    """Which models an estimator of several believed, over all logs, and how honest its sigma was."""
    lines = []
    for name in dict.fromkeys(name for _, name in scores.beliefs):
        found = {log: each for (log, whose), each in scores.beliefs.items() if whose == name}
        found = {log: each for log, each in found.items() if not scores.faults.get(log)} or found
        shares = [each.share() for each in found.values()]
        mean = {model: float(np.mean([share[model] for share in shares])) for model in shares[0]}
        ranked = sorted(mean.items(), key=lambda each: -each[1])
        shown = ", ".join(f"{model} {share:.0%}" for model, share in ranked)
        sigma = float(np.median([each.sigma_deg for each in found.values()]))
        honest = [
            each.interval(scores.truth[log][None], scores.counted[log][None])
            for log, each in found.items()
            if log in scores.scored
        ]
        inside = f"its σ is {sigma:.1f}° in the median"
        if honest:
            covered, sigmas, errors = np.array(honest).T
            rmse = float(np.sqrt(np.nanmean(errors**2)))
            inside = Interval(float(np.nanmean(covered)), float(np.nanmedian(sigmas)), rmse).text
        lines.append(f"{name} believed, in share of the time: {shown}; {inside}.")
    return lines
