"""Detection of faults that begin during a log: bias jumps, stuck or saturated axes, and vibration."""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d

from ..dataset.stretches import blocks_of, stretches
from .cleaning import frozen_stretches, least_steps
from .recording import Array
from .thresholds import CLEAN, FAULT
from .truth import LONG_S, bias_over_time

FaultKind = Literal["bias jump", "stuck axis", "saturation", "vibration"]
Sensor = Literal["gyroscope", "accelerometer"]

MOST_STEPS = 8
"""Largest number of bias jumps of one axis that are searched for."""


SLOW_S = 0.05
"""Period above which motion does not count as vibration [s]."""
NORMAL = 1.4826
"""Standard deviation of a normal distribution divided by its median absolute deviation."""


class SensorFault(NamedTuple):
    """A fault of a sensor during a part of a log."""

    kind: FaultKind
    sensor: Sensor
    axes: str
    """Affected axes, such as "x" or "xyz"."""
    start_s: float
    """Start time, from the first sample of the log [s]."""
    end_s: float
    """End time [s]; at the latest, the last sample of the log."""
    evidence: str
    """Evidence for the fault, in a sentence with a number."""

    @property
    def name(self) -> str:
        """Kind, sensor and axes of the fault, in a few words."""
        return f"{self.kind}, {self.sensor} {self.axes}"

    @property
    def sentence(self) -> str:
        """Time and evidence of the fault, in a sentence."""
        return f"{self.start_s:.1f} s to {self.end_s:.1f} s: {self.evidence}"


def find_faults(
    time: Array,
    readings: Array,
    stuck: NDArray[np.bool_],
    *,
    even_gyro: Array,
    quat: Array,
    rate_hz: float,
) -> tuple[SensorFault, ...]:
    """Find the faults of a log, in the order of their start times.

    Args:
        time: Recorded stamps of the readings (T,) [s].
        readings: Recorded readings of gyroscope [rad/s] and accelerometer [m/s²] (T, 6).
        stuck: Samples of each axis that belong to a run of equal readings (T, 6).
        even_gyro: Evenly sampled angular rate (N, 3) [rad/s]; NaN where missing.
        quat: True attitude quat_WB at the even samples (N, 4); NaN where not known.
        rate_hz: Even samples per second.
    """
    since = time - time[0]
    found = list(saturations(since, readings, stuck))
    clipped = {fault[1:3]: fault for fault in found}
    for fault in stuck_axes(since, stuck):
        over = clipped.get(fault[1:3])
        if over is None or fault.start_s < over.start_s or fault.end_s > over.end_s:
            found.append(fault)
    found += vibrations(since, readings[:, :3], readings[:, 3:])
    found += bias_jumps(even_gyro, quat, rate_hz)
    return tuple(sorted(found, key=lambda fault: fault.start_s))


def stuck_axes(time: Array, stuck: NDArray[np.bool_]) -> Iterator[SensorFault]:
    """Find runs in which an axis or a sensor repeats one reading while another axis or sensor changes."""
    found: dict[tuple[Sensor, int, int], str] = {}
    for sensor, axis, part in _axes(stuck):
        for start, end in stretches(part):
            found[sensor, start, end] = found.get((sensor, start, end), "") + axis
    for (sensor, start, end), axes in found.items():
        ends = float(time[start]), float(time[end - 1])
        repeats = f"{', '.join(axes)} {'repeats' if len(axes) == 1 else 'repeat'} one number"
        others = "another axis" if len(axes) < 3 else "the other sensor"
        text = (
            f"the {sensor}'s {repeats} for {ends[1] - ends[0]:.1f} s while {others} moves: left out of scores"
        )
        yield SensorFault("stuck axis", sensor, axes, *ends, text)


def saturations(time: Array, readings: Array, stuck: NDArray[np.bool_]) -> Iterator[SensorFault]:
    """Find axes that repeatedly read a limit and never exceed it, while another axis changes."""
    period = float(np.median(np.diff(time)))
    for (sensor, axis, values), (*_, still) in zip(_axes(readings), _axes(stuck), strict=True):
        others = readings[:, :3] if sensor == "gyroscope" else readings[:, 3:]
        parts = [part for sign in (1.0, -1.0) for part in _clipped(sign * values, others, still, period)]
        if not parts:
            continue
        starts, ends, totals = zip(*parts, strict=True)
        shown = " and ".join(
            f"{limit:.3g} m/s²" if sensor == "accelerometer" else f"{np.degrees(limit):.4g} °/s"
            for limit in sorted({float(values[start]) for start in starts})
        )
        text = f"the {sensor}'s {axis} repeats {shown} for {sum(totals):.1f} s in all"
        text += " and reads nothing beyond: the end of its range"
        start, end = float(time[min(starts)]), float(time[max(ends) - 1])
        yield SensorFault("saturation", sensor, axis, start, end, text)


def vibrations(time: Array, gyro: Array, accel: Array) -> Iterator[SensorFault]:
    """Find lasting vibration of the accelerometer that starts while the vehicle moves."""
    rate_hz = 1.0 / float(np.median(np.diff(time)))
    size = max(round(FAULT.block_s * rate_hz), 1)
    blocks = blocks_of(fast_part(accel, rate_hz), size)
    if (count := len(blocks)) * FAULT.block_s < FAULT.moving_s + FAULT.lasts_s:
        return
    level = np.linalg.norm(NORMAL * np.median(np.abs(blocks), axis=1), axis=1)  # taps do not count
    moving = _moving(gyro, rate_hz, size, count)
    lasting = median_filter(level, 2 * round(0.5 * FAULT.lasts_s / FAULT.block_s) + 1, mode="nearest")
    second = round(1.0 / FAULT.block_s)
    before = k = round(FAULT.moving_s / FAULT.block_s)
    while k < count:
        usual = float(np.median(level[:k][moving[:k]])) if moving[:k].any() else np.inf
        least = max(FAULT.harmful, FAULT.rise * usual)
        rises = level[k] > least and lasting[k] > least and np.median(level[k - second : k]) <= least
        if not (rises and moving[k - before : k].mean() >= FAULT.moving_share):
            k += 1
            continue
        after = np.flatnonzero(lasting[k:] < 0.5 * least)
        end = k + int(after[0]) if after.size else count
        if (end - k) * FAULT.block_s >= FAULT.lasts_s:
            rms, quiet = (np.sqrt((part**2).sum(axis=2).mean()) for part in (blocks[k:end], blocks[:k]))
            text = f"the accelerometer vibrates by {rms:.1f} m/s² RMS above 20 Hz, by {quiet:.1f} m/s² before"
            ends = float(time[k * size]), float(time[-1] if end == count else time[end * size])
            yield SensorFault("vibration", "accelerometer", "xyz", *ends, text)
        k = end + before


def fast_part(accel: Array, rate_hz: float) -> Array:
    """Subtract the moving mean over `SLOW_S` from a specific force (T, 3), as a high-pass filter."""
    return accel - uniform_filter1d(accel, max(round(SLOW_S * rate_hz), 1), axis=0)


def bias_jumps(gyro: Array, quat: Array, rate_hz: float) -> Iterator[SensorFault]:
    """Find jumps of the gyroscope bias by comparison with rotations of the true attitude over half a second.

    Args:
        gyro: Body rate (T, 3) [rad/s]; NaN where missing.
        quat: True attitude quat_WB (T, 4); NaN where not known.
        rate_hz: Samples per second.
    """
    bias, rates, rms = bias_over_time(gyro, quat, rate_hz)
    found: list[tuple[int, int, str, float]] = []
    for axis in range(3):
        level, start, largest = 0.0, 0, 0.0
        for k, step in _steps(bias[:, axis], rates, rms):
            start, largest = (k, 0.0) if level == 0.0 else (start, largest)
            level += step
            largest = max(largest, level, key=abs)
            if abs(level) < FAULT.back * abs(largest):
                level = 0.0
                if (k - start) * LONG_S >= FAULT.jump_s:
                    found.append((start, k, "xyz"[axis], largest))
        if level != 0.0:
            found.append((start, len(bias), "xyz"[axis], largest))
    while found:
        begin = min(found)[0]
        group = [each for each in found if (each[0] - begin) * LONG_S <= FAULT.together_s]
        found = [each for each in found if each not in group]
        sizes = {axis: np.degrees(step) for *_, axis, step in sorted(group, key=lambda each: each[2:])}
        shown = " and ".join(f"{size:+.1f} °/s about {axis}" for axis, size in sizes.items())
        text = f"the gyroscope's bias jumps by {shown}, against turns of the true attitude over {LONG_S:g} s"
        end = max(end for _, end, *_ in group)
        last = (len(gyro) - 1) / rate_hz if end == len(bias) else end * LONG_S
        yield SensorFault("bias jump", "gyroscope", "".join(sizes), begin * LONG_S, last, text)


def _steps(bias: Array, rates: Array, rms: Array) -> list[tuple[int, float]]:
    """Find the rotations (n,) at which the bias of an axis jumps, and the sizes of the jumps [rad/s].

    At every rotation, bias = a + m·ω + s·[after] is fitted by least squares to the time before and after.
    Errors of scale and mounting are proportional to the rate ω and do not contribute to the step s. Fast
    rotations have smaller weights.
    """
    bias, found = bias.copy(), []
    while len(found) < MOST_STEPS:
        fits = [_step(bias, rates, rms, k) for k in range(len(bias) + 1)]
        surely = [sigmas if abs(step) > np.radians(FAULT.step_deg) else 0.0 for step, sigmas in fits]
        k = int(np.argmax(surely))
        if surely[k] < FAULT.sigmas:
            break
        found.append((k, fits[k][0]))
        bias[k:] -= fits[k][0]
    return sorted(found)


def _step(bias: Array, rates: Array, rms: Array, k: int) -> tuple[float, float]:
    """Return the step of a bias (n,) at rotation k, in rad/s and in standard errors.

    0 if there are too few data.
    """
    most, fewest = round(FAULT.step_s / LONG_S), round(FAULT.least_step_s / LONG_S)
    window = np.arange(max(k - most, 0), min(k + most, len(bias)))
    known = np.isfinite(bias[window])
    for side in (known[window < k], known[window >= k]):
        if side.sum() < fewest or side.mean() < 0.5:
            return 0.0, 0.0
    window = window[known]
    after = window >= k
    weight = 1.0 / (FAULT.at_rest + rms[window])
    columns = weight[:, None] * np.column_stack([np.ones(len(window)), rates[window], after])
    inverse = np.linalg.pinv(columns.T @ columns)
    y, beyond = weight * bias[window], np.zeros(len(window))
    solution = np.zeros(len(inverse))
    for _ in range(3):  # what is far off counts no more than four standard deviations
        solution = inverse @ (columns.T @ (y - beyond))
        off = y - columns @ solution
        limit = 4.0 * NORMAL * float(np.median(np.abs(off)))
        beyond = off - off.clip(-limit, limit)
    squares = ((y - columns @ solution) ** 2).sum()
    sd = np.sqrt(squares / max(len(y) - len(solution), 1) * inverse[-1, -1])
    return float(solution[-1]), float(abs(solution[-1]) / max(sd, 1e-12))


def _clipped(
    values: Array, sensor: Array, stuck: NDArray[np.bool_], period: float
) -> Iterator[tuple[int, int, float]]:
    """Return first sample, end and total time [s] of the parts of an axis (T,) clipped at an upper limit."""
    near, least = FAULT.near * least_steps(values[:, None])[0], CLEAN.moves * least_steps(sensor)
    frozen = np.append((sensor[1:] == sensor[:-1]).all(axis=1), False)
    starts = frozen_stretches(values[:, None], max(round(FAULT.run_s / period), 2))[:, 0]
    levels, counts = np.unique(values, return_counts=True)
    often = levels[counts * period >= FAULT.clipped_s]
    limits = np.intersect1d(values[starts[~frozen[starts]]], often)
    for limit in limits[limits > np.median(values)]:
        at = values == limit
        count = np.append(0, np.cumsum(at))
        below = stretches(values <= limit)
        for first, last in below[np.diff(count[below])[:, 0] * period >= FAULT.clipped_s]:
            close = [(first + a, first + b) for a, b in stretches(values[first:last] > limit - near)]
            piled = [(a, b) for a, b in close if at[a:b].mean() >= FAULT.piled]
            runs = [(a, b) for a, b in piled if (sensor[max(a - 1, 0) : b + 1].std(axis=0) > least).any()]
            total = sum(int(at[a:b].sum()) for a, b in runs) * period
            alone = len(runs) == 1 and (limit < values.max() or stuck[runs[0][0] : runs[0][1]].any())
            if total >= FAULT.clipped_s and not alone:
                yield piled[0][0], piled[-1][1], total


def _moving(gyro: Array, rate_hz: float, size: int, count: int) -> NDArray[np.bool_]:
    """Mark blocks (count,) in which the vehicle rotates back and forth, within a second around each block."""
    slow = uniform_filter1d(gyro, max(round(0.1 * rate_hz), 1), axis=0)
    span = max(round(1.0 / FAULT.block_s) * size, 1)
    variance = uniform_filter1d(slow**2, span, axis=0) - uniform_filter1d(slow, span, axis=0) ** 2
    at = np.minimum(np.arange(count) * size + size // 2, len(gyro) - 1)
    return np.asarray(variance[at].sum(axis=1) > FAULT.moving**2)


def _axes(values: NDArray) -> Iterator[tuple[Sensor, str, NDArray]]:
    """Yield each column of (T, 6) with its sensor and axis."""
    sensors: tuple[Sensor, Sensor] = ("gyroscope", "accelerometer")
    for k, sensor in enumerate(sensors):
        for axis, column in zip("xyz", values[:, 3 * k : 3 * k + 3].T, strict=True):
            yield sensor, axis, column
