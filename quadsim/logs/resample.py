"""Resampling of a recording to even samples, with counts of doubtful samples.

Samples are NaN in gaps of the log, and estimators count them as missing. The truth is NaN where it is not
known, and such samples are not scored.
"""

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import firwin, oaconvolve
from scipy.spatial.transform import Rotation, Slerp

from ..dataset.store import LABELS, MEASURED
from ..rotation import quat_rotate, wxyz_from_xyzw, xyzw_from_wxyz
from .cleaning import EXACT_S, LONGEST_GAP_S, forward, gaps_of, longest_part, stuck_samples
from .log_faults import find_faults
from .log_report import LogReport
from .mounting import level, turn_at_rest
from .recording import Array, Recording
from .truth import align

PASS = 0.8
"""Pass band of the anti-alias filter as a share of the new Nyquist frequency; the −6 dB point is midway
between."""
SENSOR_GAP_S = 0.25
"""Longest time between readings of other sensors that are interpolated [s]; ESCs may report at 10 Hz."""
TRUTH_GAP_S = 0.1
"""Longest time between attitudes that are interpolated [s]."""


def resample(log: Recording, rate_hz: float = 200.0) -> tuple[xr.Dataset, LogReport]:
    """Resample a log to even samples, as one flight in the layout of a dataset.

    If the log has a higher rate, a zero-phase low-pass prevents aliasing. If it has a lower rate, the samples
    are interpolated by splines. Body rate and specific force are never filtered across a gap.

    Args:
        log: A recording in FLU body axes and a world with z up.
        rate_hz: Samples per second.

    Returns:
        The flight and its report. The flight has the variables gyro, accel, quat, scored and, if known,
        position, rotor_vel and mag, over (flight, time, …), and the report as attribute `log`.

    Raises:
        ValueError: There are too few samples, or the sample rate cannot be converted.
    """
    log, counts = longest_part(log)
    time, readings = log.time, np.concatenate([log.gyro, log.accel], axis=1)
    gap, steps = gaps_of(time)
    source_rate = steps["source_rate_hz"]
    stuck = stuck_samples(readings, 1.0 / source_rate)
    corner = 0.5 * (1 + PASS) * rate_hz / 2 if source_rate > 1.01 * rate_hz else None
    grid = time[0] + np.arange(int((time[-1] - time[0]) * rate_hz * (1 + 1e-12) + 1e-6) + 1) / rate_hz
    even = np.full((grid.size, 6), np.nan)
    for part in np.split(np.arange(time.size), np.flatnonzero(gap) + 1):
        inside = (grid >= time[part[0]] - EXACT_S) & (grid <= time[part[-1]] + EXACT_S)
        if part.size >= 4 and inside.any():
            even[inside] = _even(time[part], readings[part], grid[inside], rate_hz, source_rate, corner)
    even[np.interp(grid, time, stuck.any(axis=1)) > 0.0] = np.nan
    gyro, accel = even[:, :3], even[:, 3:]
    arrays, truth_rate = _truth(log, grid)
    quat = arrays["quat"]
    arrays |= {"gyro": gyro, "accel": accel} | {
        name: interpolated(grid, *track, SENSOR_GAP_S) for name, track in log.sensors.items()
    }
    attitude = np.isfinite(quat).all(axis=1)
    known = attitude & np.isfinite(even).all(axis=1)
    gravity = quat_rotate(quat[known], accel[known]).mean(axis=0) if known.any() else None
    report = LogReport(
        log,
        counts | steps | {"truth_rate_hz": truth_rate, "truth_share": float(attitude.mean())},
        sensor_faults=find_faults(time, readings, stuck, even_gyro=gyro, quat=quat, rate_hz=rate_hz),
        gravity=gravity,
        aligned=align(gyro, quat, rate_hz),
        level=level(gyro, accel, rate_hz) if gravity is None or log.truth_axes == "imu" else None,
        rest=turn_at_rest(gyro, accel, rate_hz),
        filter_hz=corner,
    )
    return _dataset(arrays, rate_hz, log.name, report), report


def _even(
    time: Array, readings: Array, grid: Array, rate_hz: float, source_rate: float, corner: float | None
) -> Array:
    """Resample gapless readings, (m, 6), to a grid of times within them."""
    if corner is None:
        return CubicSpline(time, readings)(grid)
    count = max(int((time[-1] - time[0]) * source_rate) + 1, 4)
    fine = np.linspace(time[0], time[-1], count)
    fine_rate = (count - 1) / (fine[-1] - fine[0])
    width = (1 - PASS) * rate_hz / 2
    taps = int(np.ceil(3.3 * fine_rate / width)) | 1  # Hamming: −53 dB beyond that width
    kernel = np.asarray(firwin(taps, corner, fs=fine_rate), np.float64)
    ends = min(taps // 2, count - 1)
    # Point reflection at the ends, so that no step is filtered there.
    values = CubicSpline(time, readings)(fine)
    head, tail = 2 * values[0] - values[ends:0:-1], 2 * values[-1] - values[-2 : -2 - ends : -1]
    padded = np.concatenate([head, values, tail])
    smooth = oaconvolve(padded, kernel[:, None], mode="same", axes=0)[ends : ends + count]
    return CubicSpline(fine, smooth)(grid)


def interpolated(grid: Array, time: Array, values: Array, longest_s: float) -> Array:
    """Interpolate valid readings to the grid (T, ·).

    The result is NaN outside the stamps and in long gaps.
    """
    good = np.flatnonzero(np.isfinite(values).all(axis=1) & np.isfinite(time))
    good = good[forward(time[good])]
    if good.size < 2:
        return np.full((grid.size, values.shape[1]), np.nan)
    even = np.stack([np.interp(grid, time[good], column) for column in values[good].T], axis=1)
    return np.where(_between(grid, time[good], longest_s)[:, None], even, np.nan)


def _between(grid: Array, time: Array, longest_s: float) -> NDArray[np.bool_]:
    after = np.clip(np.searchsorted(time, grid), 1, time.size - 1)
    inside = (grid >= time[0] - EXACT_S) & (grid <= time[-1] + EXACT_S)
    return inside & (time[after] - time[after - 1] <= longest_s)


def _truth(log: Recording, grid: Array) -> tuple[dict[str, Array], float]:
    """Return attitude, position and scoring mark on the grid (NaN if unknown), and the rate of the truth."""
    out = {"quat": np.full((grid.size, 4), np.nan), "scored": np.zeros(grid.size, bool)}
    if log.quat is None or log.truth_time is None:
        return out, 0.0
    length = np.linalg.norm(log.quat, axis=1)
    near = (log.truth_time >= grid[0] - LONGEST_GAP_S) & (log.truth_time <= grid[-1] + LONGEST_GAP_S)
    kept = np.flatnonzero(near & (length > 0.5) & np.isfinite(length))
    kept = kept[forward(log.truth_time[kept])]
    if kept.size < 2:
        return out, 0.0
    time = log.truth_time[kept]
    known = _between(grid, time, TRUTH_GAP_S)
    if known.any():
        turns = Slerp(time, Rotation.from_quat(xyzw_from_wxyz(log.quat[kept])))
        out["quat"][known] = wxyz_from_xyzw(turns(grid[known].clip(time[0], time[-1])).as_quat())
    after = np.clip(np.searchsorted(time, grid), 1, time.size - 1)
    mark = np.ones(kept.size, bool) if log.marked is None else log.marked[kept]
    out["scored"] = known & mark[after] & mark[after - 1]
    if log.position is not None:
        out["position"] = interpolated(grid, time, log.position[kept], TRUTH_GAP_S)
    return out, float(1.0 / np.median(np.diff(time)))


def _dataset(arrays: dict[str, Array], rate_hz: float, name: str, report: LogReport) -> xr.Dataset:
    steps = len(arrays["gyro"])
    variables: dict[str, tuple] = {
        "scored": (("flight", "time"), arrays.pop("scored")[None], {"long_name": "marked for scoring"})
    }
    for each, values in arrays.items():
        kind = MEASURED[each]
        about = {"units": kind.units, "long_name": kind.long_name}
        variables[each] = (("flight", "time", kind.dim), values[None], about)
    return xr.Dataset(
        variables,
        coords={
            "flight": [0],
            "time": ("time", np.arange(steps) / rate_hz, {"units": "s"}),
            "axis": LABELS["axis"],
            "quat_axis": LABELS["quat_axis"],
            "valid_steps": ("flight", [steps]),
            "end_reason": ("flight", np.array([""], dtype=object)),
        },
        attrs={"rate_hz": rate_hz, "duration_s": steps / rate_hz, "source": name, "log": report},
    )
