"""Checks of the stamps and readings of a recording before resampling, and the choice of its longest part."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..config.ranges import FORCE_MAX, RATE_MAX
from ..dataset.stretches import stretches
from .recording import Array, Recording
from .thresholds import CLEAN

LONGEST_GAP_S = 30.0
"""Longest gap within a part of a recording [s]; a longer gap begins another part."""
RATES_HZ = (40.0, 10_000.0)
"""Range of sample rates that can be resampled [Hz]."""
EXACT_S = 1e-7
"""Largest difference between stamps that count as equal [s]."""
FEWEST = 8
"""Smallest number of samples in a part."""


def longest_part(log: Recording) -> tuple[Recording, dict[str, float]]:
    """Return the longest part of a recording with finite readings and increasing stamps.

    Args:
        log: A recording on its own stamps.

    Returns:
        The part, and counts of dropped and doubtful samples, by the names of `LogReport.counts`.

    Raises:
        ValueError: There are too few samples, the rows are not in order, or no IMU has this sample rate.
    """
    stamped = np.isfinite(log.time)
    back = np.diff(log.time[stamped]) < -CLEAN.back_s
    if back.sum() > CLEAN.unsorted * back.size:
        share = f"{100 * back.mean():.0f} %"
        raise ValueError(f"{log.name}: {share} of the stamps go back: sort the rows by time")
    parts = split_at_gaps(log)
    longest = max(parts, key=lambda part: part.time.size)
    readings = np.concatenate([longest.gyro, longest.accel], axis=1)
    finite = np.isfinite(readings).all(axis=1)
    beyond = finite & (np.abs(readings) > np.repeat([RATE_MAX, FORCE_MAX], 3)).any(axis=1)
    if beyond.sum() <= CLEAN.rare * finite.sum():  # many are no spikes, but of another unit
        finite &= ~beyond
    steps = np.diff(longest.time[finite])
    closest = CLEAN.closest * float(np.median(steps[steps > EXACT_S])) if (steps > EXACT_S).any() else 0.0
    rows = np.flatnonzero(finite)
    rows = rows[forward(longest.time[rows], max(EXACT_S, closest))]
    time = longest.time[rows]
    if time.size < FEWEST:
        lacking = f"{time.size} usable samples whose stamps go forward; at least {FEWEST} are required"
        raise ValueError(f"{log.name}: {lacking}")
    period, length = float(np.median(np.diff(time))), time[-1] - time[0]
    if not RATES_HZ[0] <= 1.0 / period <= RATES_HZ[1]:
        allowed = f"{RATES_HZ[0]:g} to {RATES_HZ[1]:g} are allowed: {_unit_of_stamps(period)}"
        raise ValueError(f"{log.name}: {1.0 / period:.3g} samples per second; {allowed}")
    if length > CLEAN.sparse * period * time.size:
        few = f"{time.size} samples at {1.0 / period:.0f} Hz in {length:.0f} s"
        raise ValueError(f"{log.name}: {few}: most of the log is missing")
    readings = readings[rows]
    return replace(longest, time=time, gyro=readings[:, :3], accel=readings[:, 3:]), {
        "parts": len(parts),
        "missing": int((~finite).sum() + (~stamped).sum()),
        "stamps_back": int(finite.sum()) - rows.size,
        "clock_back_ms": round(-1e3 * float(steps.min(initial=0.0))),
        "repeated": int((readings[1:] == readings[:-1]).all(axis=1).sum()),
    }


def split_at_gaps(log: Recording) -> list[Recording]:
    """Split a recording at gaps of more than `LONGEST_GAP_S`; the parts are in the order of the log.

    Samples whose stamps are far from those on both sides are dropped, so that a single clock error does not
    begin a new part.

    Args:
        log: A recording on its own stamps.

    Raises:
        ValueError: Every part has too few samples.
    """
    stamped = np.flatnonzero(np.isfinite(log.time))
    together = _between_gaps(log.time, stamped)
    if not together:
        period = float(np.median(np.abs(np.diff(log.time[stamped])))) if stamped.size > 1 else 0.0
        hint = f": {period:.3g} s apart, {_unit_of_stamps(period)}" if period > LONGEST_GAP_S else ""
        raise ValueError(f"{log.name}: 0 usable samples; at least {FEWEST} are required{hint}")
    parts = _between_gaps(log.time, np.concatenate(together))
    return [replace(log, time=log.time[part], gyro=log.gyro[part], accel=log.accel[part]) for part in parts]


def _between_gaps(time: Array, rows: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return, for each part, the rows that have `FEWEST` neighbours nearby in time."""
    cuts = np.flatnonzero(np.abs(np.diff(time[rows])) > LONGEST_GAP_S) + 1
    return [part for part in np.split(rows, cuts) if part.size >= FEWEST]


def gaps_of(time: Array) -> tuple[NDArray[np.bool_], dict[str, float]]:
    """Return which steps of the stamps (T,) are gaps, (T − 1,), and counts as in `LogReport.counts`."""
    steps = np.diff(time)
    period = float(np.median(steps))
    gap = steps > max(CLEAN.gap * period, period + CLEAN.jitter_s)
    # A late stamp is followed by a short step and an early one comes after one; a lost sample has neither.
    beside = np.convolve(steps / period, [1.0, 1.0], "valid")
    alone = np.minimum(np.append(beside, np.inf), np.insert(beside, 0, np.inf)) > CLEAN.lost + 1.0
    lost = (steps / period > CLEAN.lost) & alone & ~gap
    return gap, {
        "samples": time.size,
        "duration_s": float(time[-1] - time[0]),
        "source_rate_hz": 1.0 / period,
        "jitter_ms": float(np.std(steps[~gap & ~lost])) * 1e3,
        "gaps": int(gap.sum()),
        "gap_s": float((steps[gap] - period).sum()),
        "longest_gap_s": float(steps[gap].max(initial=0.0)),
        "lost": int(lost.sum()),
    }


def least_steps(readings: Array) -> Array:
    """Return the smallest change between two readings of each axis; infinite if an axis never changes."""
    steps = np.abs(np.diff(readings, axis=0))
    return np.where(steps > 0, steps, np.inf).min(axis=0)


def frozen_stretches(readings: Array, least: int) -> NDArray[np.int64]:
    """Return first sample and end of each run of at least `least` equal readings (T, ·).

    There are none if all readings are equal.
    """
    same = (readings[1:] == readings[:-1]).all(axis=1)
    runs = stretches(same) + np.array([0, 1])
    return runs[(np.diff(runs)[:, 0] >= least) & ~same.all()]


def stuck_samples(readings: Array, period: float) -> NDArray[np.bool_]:
    """Mark samples (T, 6) of an axis in a run of equal readings while another axis of the sensor changes.

    Runs of equal readings on all axes of one sensor, while the other sensor changes, are also marked.
    """
    least, stuck = max(round(CLEAN.stuck_s / period), 3), np.zeros(readings.shape, bool)
    for first, moves in ((0, CLEAN.force_moves), (3, CLEAN.rate_moves)):
        sensor, other = readings[:, first : first + 3], readings[:, 3 - first : 6 - first]
        limits = CLEAN.moves * least_steps(sensor)
        for k in range(3):
            for start, end in frozen_stretches(sensor[:, [k]], least):
                stuck[start:end, first + k] = (sensor[start:end].std(axis=0) > limits).any()
        for start, end in frozen_stretches(sensor, least):
            if np.linalg.norm(other[start:end].std(axis=0)) > moves:
                stuck[start:end, first : first + 3] = True
    return stuck


def _unit_of_stamps(period: float) -> str:
    """Return the likely unit of stamps whose period cannot be in seconds."""
    for unit, per_s in {"ms": 1e3, "us": 1e6, "ns": 1e9}.items():
        if 50.0 <= per_s / period <= 4000.0:
            return f'are the stamps in {unit} (time.unit = "{unit}")?'
    return "look at the unit of the stamps"


def forward(time: Array, least: float = 0.0) -> NDArray[np.bool_]:
    """Mark stamps (T,) that are later than all previous ones by more than a time [s]."""
    return np.diff(np.maximum.accumulate(time), prepend=-np.inf) > least
