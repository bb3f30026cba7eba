"""What scores on recorded logs do and do not show, in words."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from estimators.evaluation.beliefs import Coverage
from estimators.evaluation.logs import KNOWN, LEVEL, RAW, LogScores
from estimators.evaluation.without_truth import LOW_PASS_S

CLEAR = 0.8
"""An estimator whose error is above this share of a level guess's has shown little."""
LARGE_BIAS = math.radians(1.0)
"""Gyroscope bias that estimators have to find [rad/s]."""
GAINED = 0.5
"""Share of the error, after the bias is removed, below which the bias is named as its cause."""
ADVICE = {
    "bias jump": "Calibration does not cure a bias that jumps. Check the sensor's supply, temperature "
    "and mount, replace the sensor if the jump returns, and fly with an estimator that tracks the bias.",
    "stuck axis": "Calibration does not cure an axis that sticks. Check the bus and its driver.",
    "saturation": "An axis saturates. Select a wider range of the sensor, or move more gently.",
    "vibration": "The vibration has a mechanical cause. Check propellers, bearings and the IMU's mount.",
}
"""Kind of fault to what its user is to do."""


class LogVerdict(NamedTuple):
    """The answer, and its conditions."""

    headline: str
    lines: list[str]


def log_verdict(scores: LogScores) -> LogVerdict:
    """Which estimator had the smallest error, how a level guess compares, and what limits the finding."""
    compared = [line for log in scores.compared for line in _compared(scores, log)]
    notes = [f"{name} is not ranked: it {reason.rstrip('.')}." for name, reason in scores.unranked.items()]
    if not scores.scored:
        lines = [*compared, *_failing(scores), *_believed(scores), *notes]
        return LogVerdict(_headline_without_truth(scores), lines)
    if not scores.ranked:
        return LogVerdict("No estimator is ranked.", [*compared, *notes])
    logs, level = scores.headline, scores.mean(LEVEL, RAW)
    seconds = sum(scores.logs[log].counted_s for log in logs)
    lines = [
        f"{len(logs)} log{'s' if len(logs) > 1 else ''}, {seconds:.0f} s scored, from an unknown attitude, "
        f"with the gyroscope as recorded. A level guess has an error of {level:.2f}°.",
        *([scores.tuning] if scores.tuning else []),
    ]
    for part in (_failing, _by_log, _bias, _believed):
        lines += part(scores)
    lines += compared
    if len(logs) == 1:
        lines.append("One log is not enough to choose an estimator for other logs.")
    return LogVerdict(_headline(scores, level), lines + notes)


def _headline(scores: LogScores, level: float) -> str:
    best, logs = scores.ranked[0], scores.headline
    error = scores.mean(best, RAW)
    over = ", over the logs without a fault" if scores.faulty else ""
    if logs == scores.faulty:
        over = f", but {'the log has' if len(logs) == 1 else 'all logs have'} a sensor fault"
    if error > CLEAR * level:
        text = f"No estimator is much better than a level guess ({level:.2f}°){over}"
        return f"{text}; the best is {best}, {error:.2f}°."
    tied = f" (the difference from {', '.join(scores.tied)} is not significant)" if scores.tied else ""
    if scores.tied is None:
        tied = " (too little is scored to say which differences are significant)"
    return f"Smallest error: {best}, {error:.2f}° inclination RMSE{tied}{over}."


def _headline_without_truth(scores: LogScores) -> str:
    compared = scores.compared
    sound = [log for log in compared if not scores.logs[log].faults] or list(compared)
    found = list(dict.fromkeys((compared[log].favoured, compared[log].undecided) for log in sound))
    favoured, undecided = found[0]
    evidence = f"the evidence favours no estimator: {undecided}"
    if len(found) > 1:
        evidence = "the evidence differs from log to log"
    elif favoured:
        evidence = f"the mean force favours {', '.join(favoured)}"
    over = ", over the logs without a fault" if len(sound) < len(compared) else ""
    lacking = "The log has" if len(compared) == 1 else "The logs have"
    return f"{lacking} no true attitude, so no errors are given; {evidence}{over}."


def _failing(scores: LogScores) -> Iterator[str]:
    """Logs in which a fault begins, apart from the others, and what their user is to do."""
    faulty = scores.faulty
    if faulty and scores.headline == faulty:
        where = "the log" if len(faulty) == 1 else "every log"
        yield f"A sensor fault begins in {where}, so all errors here include the effect of a faulty sensor."
    elif faulty:
        count = f"{len(faulty)} of {len(scores.scored)} logs {'has' if len(faulty) == 1 else 'have'}"
        yield f"{count} a sensor fault. Means and headline exclude {', '.join(faulty)}."
    on_log = scores.on_logs().reindex(scores.ranked)
    kinds = set()
    for name, log in scores.logs.items():
        text = f"{name}, {'; '.join(fault.sentence for fault in log.faults)}."
        if name in on_log and bool(on_log[name].notna().any()):
            best = on_log[name].idxmin()
            text += f" The smallest error on this log is {on_log.at[best, name]:.2f}° ({best})."
        if log.faults:
            yield text
        kinds |= {fault.kind for fault in log.faults}
    yield from (advice for kind, advice in ADVICE.items() if kind in kinds)


def _by_log(scores: LogScores) -> Iterator[str]:
    """On how many logs the best is the best, and where it is furthest behind."""
    best, logs = scores.ranked[0], scores.headline
    if len(logs) < 2:
        return
    errors = scores.on_logs().loc[sorted(scores.ranked), logs]
    first = int((errors.idxmin() == best).sum())
    text = f"{best} has the smallest error on {first} of {len(logs)} logs"
    if first < len(logs):
        worst = (errors.loc[best] / errors.min()).idxmax()
        value, name = errors[worst].min(), errors[worst].idxmin()
        text += f"; its largest disadvantage is on {worst}, where its error is {errors.at[best, worst]:.2f}° "
        text += f"and that of {name} is {value:.2f}°"
    yield f"{text}."


def _bias(scores: LogScores) -> Iterator[str]:
    """Estimators that lose by a gyroscope bias that they do not find."""
    logs = [scores.logs[log] for log in scores.headline]
    sound = [log for log in logs if not any(fault.sensor == "gyroscope" for fault in log.faults)]
    known = [log.bias.significant for log in sound if log.bias and np.isfinite(log.bias.mean).all()]
    largest = float(np.abs(known).max(initial=0.0))
    if known and largest == 0.0:
        yield "No gyroscope bias differs significantly from zero, so no bias is removed."
    if largest < LARGE_BIAS:
        return
    errors = {name: (scores.mean(name, RAW), scores.mean(name, KNOWN)) for name in scores.ranked}
    losing = [
        f"{name} ({raw:.1f}°, without the bias {without:.1f}°)"
        for name, (raw, without) in errors.items()
        if without < GAINED * raw
    ]
    text = f"The gyroscope has a bias of up to {math.degrees(largest):.1f} °/s"
    if losing:
        text += f", which these estimators do not correct in time: {', '.join(losing)}. Calibrate the sensor "
        text += "with `quadsim identify --still`"
    yield f"{text}."


def _compared(scores: LogScores, log: str) -> Iterator[str]:
    """How far estimators are apart on a log without truth, and what its forces favour."""
    found = scores.compared[log]
    if found.apart:
        median, most = np.median(list(found.apart.values()), axis=0)
        yield (
            f"{log} has no true attitude: the inclinations of two estimators differ by {median:.1f}° in the "
            f"median and by {most:.1f}° in the 95th percentile (median over pairs)."
        )
    low, high = min(found.force.values()), max(found.force.values())
    chosen = ", ".join(found.favoured) or f"no estimator: {found.undecided}"
    flights = scores.logs[log].flights
    seconds = min(LOW_PASS_S, flights.gyro.shape[1] / flights.rate_hz)
    yield (
        f"{log}: rotated to the world and averaged over {seconds:.3g} s, the horizontal force is {low:.2f} "
        f"m/s² to {high:.2f} m/s² (RMS), {found.level_force:.2f} m/s² for a level guess. It is near zero for "
        f"a correct attitude, and for a level guess if the vehicle stays level. It favours {chosen}."
    )


def _believed(scores: LogScores) -> Iterator[str]:
    """Which models an estimator of several believed, over all logs, and how honest its sigma was."""
    for name in dict.fromkeys(name for log in scores.logs.values() for name in log.beliefs):
        found = [log for log in scores.logs.values() if name in log.beliefs]
        found = [log for log in found if not log.faults] or found
        shares = [log.beliefs[name].share() for log in found]
        mean = {model: float(np.mean([share[model] for share in shares])) for model in shares[0]}
        ranked = sorted(mean.items(), key=lambda each: -each[1])
        shown = ", ".join(f"{model} {100 * share:.0f} %" for model, share in ranked)
        sigma = np.median([log.beliefs[name].sigma_deg for log in found])
        inside = f"its σ is {sigma:.1f}° in the median"
        if honest := [log.interval(name) for log in found if log.comparison is None]:
            covered, sigmas, errors = np.array(honest).T
            rmse = float(np.sqrt(np.nanmean(errors**2)))
            inside = Coverage(float(np.nanmean(covered)), float(np.nanmedian(sigmas)), rmse).text
        yield f"Mean model probabilities of {name}: {shown}; {inside}."
