"""From a recording on its own stamps to even samples at the network's rate, with everything odd counted.

Nothing is bridged in silence: where the log has a gap the samples are NaN, which every estimator counts as
missing, and where the truth is not known it is NaN, which no score counts.
"""

from dataclasses import asdict, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from scipy.signal import firwin, oaconvolve
from scipy.spatial.transform import Rotation, Slerp

from ..config.ranges import FORCE_MAX, RATE_MAX
from ..dataset.store import LABELS, VARIABLES, Variable
from ..rotation import (
    matrix_from_quat,
    quat_from_roll_pitch,
    quat_rotate,
    roll_pitch_of_up,
    wxyz_from_xyzw,
    xyzw_from_wxyz,
)
from .faults import find_faults
from .log_report import AXES, LONGEST_GAP_S, LogReport
from .mean_force import level, turn_at_rest
from .mounting import mount_text
from .recording import Array, Recording, Track
from .truth_delay import align

PASS = 0.8
"""Share of the new Nyquist frequency that the anti-alias filter lets through; −6 dB is midway to it."""
GAP, JITTER_S = 2.5, 4e-3
"""A step of more than this many sample periods, and of more than a period and this time [s], is a gap, in
which samples are NaN. Shorter ones are interpolated: one lost sample, or stamps that a computer took, each up
to 2 ms late or early."""
LOST = 1.5
"""A step of this many periods that no short one beside it makes up for is a lost sample."""
SENSOR_GAP_S = 0.25
"""Readings of other sensors further apart than this are not interpolated: ESCs may report at 10 Hz."""
TRUTH_GAP_S = 0.1
"""Attitudes further apart than this are not interpolated."""
STUCK = 3
"""So many equal readings in a row at the end of an axis' range are a saturation."""
RATES_HZ = (40.0, 10_000.0)
"""Sample rates that make sense to bring to the network's."""
UNSORTED, BACK_S = 0.05, 0.01
"""Share of the stamps that go back by more than this time [s] above which rows are out of order."""
STUCK_S = 0.5
"""Equal readings of an axis over this time [s] are left out where another axis of the sensor moves,"""
MOVES = 10.0
"""by a standard deviation of this many of its least steps: at rest a coarse sensor repeats itself."""
FORCE_MOVES, RATE_MOVES = 0.5, 0.1
"""So are all axes of a sensor where the other moves by this standard deviation [m/s², rad/s]."""
VIBRATION_S = 0.05
"""Motion slower than this is no vibration [s]."""
EXACT_S = 1e-7
"""Stamps this close are the same [s]: clocks count microseconds, or lose digits since 1970."""
RARE = 0.01
"""Share of readings beyond any sensor's range up to which they are left out as spikes."""
FEWEST = 8
"""Samples that a part has at least."""
SPARSE = 20.0
"""A part may last this many times as long as its samples fill at their rate."""
CLOSEST = 0.05
"""Samples closer than this share of the sample period are one."""
MEASURED = VARIABLES | {"mag": Variable("axis", "T", "magnetic field in body axes")}
"""Variables of a log's dataset."""


def _unit_of_stamps(rate_hz: float) -> str:
    """What stamps at a rate that cannot be are likely in."""
    units = {"ms": 1e3, "us": 1e6, "ns": 1e9}
    likely = [
        f'in {unit} (time.unit = "{unit}")'
        for unit, per_s in units.items()
        if 50.0 <= rate_hz * per_s <= 4000.0
    ]
    return f"are the stamps {likely[0]}?" if likely else "look at the unit of the stamps"


def resample(log: Recording, rate_hz: float = 200.0) -> tuple[xr.Dataset, LogReport]:
    """Even samples of a log, in the layout of the simulator's datasets, one flight.

    Above the new rate a zero-phase low-pass keeps what cannot be represented from folding down; below it the
    samples are splined. Angular rate and force are never filtered across a gap.

    Args:
        log: A recording in our frames.
        rate_hz: Samples per second.

    Returns:
        Variables gyro, accel, quat, scored and where known position, rotor_vel and mag, over (flight, time,
        …); and the report.

    Raises:
        ValueError: Too few samples, or a sample rate that cannot be brought to the new one.
    """
    log, counted = longest_part(log)
    time, readings = log.time, np.concatenate([log.gyro, log.accel], axis=1)
    steps = np.diff(time)
    period = float(np.median(steps))
    source_rate = 1.0 / period
    gap = steps > max(GAP * period, period + JITTER_S)
    lost = _lost(steps / period) & ~gap
    stuck = _stuck(readings, max(round(STUCK_S / period), STUCK))
    grid = time[0] + np.arange(int((time[-1] - time[0]) * rate_hz * (1 + 1e-12) + 1e-6) + 1) / rate_hz
    even = np.full((grid.size, 6), np.nan)
    corner = 0.5 * (1 + PASS) * rate_hz / 2 if source_rate > 1.01 * rate_hz else None
    cuts = np.flatnonzero(gap) + 1
    for part in np.split(np.arange(time.size), cuts):
        inside = (grid >= time[part[0]] - EXACT_S) & (grid <= time[part[-1]] + EXACT_S)
        if part.size >= 4 and inside.any():
            even[inside] = _even(time[part], readings[part], grid[inside], rate_hz, period, corner)
    even[_near(time[stuck.any(axis=1)], grid, period)] = np.nan
    variables, truth_rate = _truth(log, grid)
    sensors = {name: _interpolated(track, grid) for name, track in log.sensors.items()}
    dataset = _dataset(log, even, variables | sensors, rate_hz)
    quat = variables["quat"]
    known = np.isfinite(quat).all(axis=1) & np.isfinite(even).all(axis=1)
    gravity = quat_rotate(quat[known], even[known, 3:]).mean(axis=0) if known.any() else None
    found = align(even[:, :3], quat, rate_hz)
    force = np.linalg.norm(log.accel, axis=1)
    rest = turn_at_rest(even[:, :3], even[:, 3:], rate_hz)
    mean = level(even[:, :3], even[:, 3:], rate_hz) if gravity is None or log.truth_axes == "imu" else None
    report = LogReport(
        format=log.format,
        truth=log.truth,
        samples=time.size,
        duration_s=float(time[-1] - time[0]),
        source_rate_hz=source_rate,
        jitter_ms=float(np.std(steps[~gap & ~lost])) * 1e3,
        gaps=int(gap.sum()),
        gap_s=float((steps[gap] - period).sum()),
        longest_gap_s=float(steps[gap].max(initial=0.0)),
        lost=int(lost.sum()),
        truth_rate_hz=truth_rate,
        truth_share=float(np.isfinite(quat).all(axis=1).mean()),
        gravity=None if gravity is None else (float(gravity[0]), float(gravity[1]), float(gravity[2])),
        truth_delay_s=None if found is None else found.delay_s,
        agreement=None if found is None else found.agreement,
        slope=None if found is None else found.slope,
        rotated_agreement=None if found is None else found.rotated_agreement,
        turned=None if found is None else found.turned,
        tilt_deg=None if mean is None else mean.tilt_deg,
        level_mount="" if mean is None else _levelling(mean.force),
        tilt_sd_deg=0.0 if mean is None else mean.sd_deg,
        rest_s=0.0 if rest is None else float(rest.seconds),
        rest_rate=0.0 if rest is None else rest.rate,
        truth_axes=log.truth_axes,
        path=log.path,
        truth_norm=_median_norm(log.quat),
        weight=float(np.median(force)),
        vibration=_vibration(log.accel, source_rate),
        upright=float(log.accel[:, 2].mean() / max(float(np.median(force)), 1e-9)),
        still=_still(readings),
        stuck=tuple(stuck.sum(axis=0).tolist()),
        sensor_faults=find_faults(
            time, log.gyro, log.accel, stuck, even_gyro=even[:, :3], quat=quat, rate_hz=rate_hz
        ),
        filter_hz=corner,
        notes=log.notes,
        **counted,
    )
    dataset.attrs["log"] = asdict(report)
    return dataset, report


def longest_part(log: Recording) -> tuple[Recording, dict[str, int]]:
    """The longest part of a recording, with finite readings and stamps that go forward.

    Args:
        log: A recording on its own stamps.

    Returns:
        The part, and counts of what was left out or is odd, by the names of `LogReport`.

    Raises:
        ValueError: Too few samples, rows out of order, or a sample rate that no IMU has.
    """
    stamped = np.isfinite(log.time)
    back = np.diff(log.time[stamped]) < -BACK_S
    if back.sum() > UNSORTED * back.size:
        share = f"{100 * back.mean():.0f} %"
        raise ValueError(f"{log.name}: {share} of the stamps go back: sort the rows by time")
    parts = split(log)
    log = max(parts, key=lambda part: part.time.size)
    unstamped = int((~stamped).sum()) - int((~np.isfinite(log.time)).sum())
    log, counted = _cleaned(log)
    time, period = log.time, float(np.median(np.diff(log.time)))
    rate = 1.0 / period
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise ValueError(
            f"{log.name}: {rate:.3g} samples a second; {RATES_HZ[0]:g} to {RATES_HZ[1]:g} are allowed: "
            f"{_unit_of_stamps(rate)}"
        )
    if time[-1] - time[0] > SPARSE * period * time.size:
        raise ValueError(
            f"{log.name}: {time.size} samples at {rate:.0f} Hz in {time[-1] - time[0]:.0f} s: "
            "most of the log is missing"
        )
    return log, counted | {"missing": counted["missing"] + unstamped, "parts": len(parts)}


def split(log: Recording) -> list[Recording]:
    """The parts of a recording between gaps of more than `LONGEST_GAP_S`, in the order of the log.

    Stamps that are far from those on both sides belong to no part: a clock that jumped once makes no new one.

    Args:
        log: A recording on its own stamps.

    Raises:
        ValueError: No part has enough samples.
    """
    stamps = log.time[np.isfinite(log.time)]
    good = np.flatnonzero(np.isfinite(log.time))
    good = good[_together(stamps)]
    cuts = np.flatnonzero(np.abs(np.diff(log.time[good])) > LONGEST_GAP_S) + 1
    parts = [part for part in np.split(good, cuts) if part.size >= FEWEST]
    if not parts:
        step = float(np.median(np.abs(np.diff(stamps)))) if stamps.size > 1 else 0.0
        hint = f": {step:.3g} s apart, {_unit_of_stamps(1 / step)}" if step > LONGEST_GAP_S else ""
        raise ValueError(f"{log.name}: {good.size} usable samples; at least {FEWEST} are required{hint}")
    if len(parts) == 1 and parts[0].size == log.time.size:
        return [log]
    return [replace(log, time=log.time[part], gyro=log.gyro[part], accel=log.accel[part]) for part in parts]


def _lost(steps: Array) -> NDArray[np.bool_]:
    """Steps of the stamps, in periods, in which a sample is lost.

    A late stamp is followed by a short step and an early one comes after one; a lost sample has neither.
    """
    beside = np.convolve(steps, [1.0, 1.0], "valid")
    alone = np.minimum(np.append(beside, np.inf), np.insert(beside, 0, np.inf)) > LOST + 1.0
    return (steps > LOST) & alone


def _still(readings: Array) -> tuple[str, ...]:
    """Sensors, or axes of one, that read the same number all the time."""
    constant = (readings == readings[0]).all(axis=0)
    found: list[str] = []
    for name, part in (("the gyroscope", slice(0, 3)), ("the accelerometer", slice(3, 6))):
        axes = np.array(AXES[part])[constant[part]].tolist()
        found += [name] if len(axes) == 3 else axes
    return tuple(found)


def _together(time: Array) -> NDArray[np.bool_]:
    """Stamps with `FEWEST` neighbours in the log that are near in time; the others are a clock's mistakes."""
    cuts = np.flatnonzero(np.abs(np.diff(time)) > LONGEST_GAP_S) + 1
    sizes = np.diff(cuts, prepend=0, append=time.size)
    return np.repeat(sizes >= FEWEST, sizes)


def _median_norm(quat: Array | None) -> float | None:
    """Median length of the quaternions that are known; None where none is."""
    if quat is None:
        return None
    length = np.linalg.norm(quat, axis=1)
    known = length > 0  # not NaN, and infinite where a number is too large to be squared
    return float(np.median(length[known])) if known.any() else None


def _cleaned(log: Recording) -> tuple[Recording, dict[str, int]]:
    """Readings with finite numbers and stamps that go forward, and how many were otherwise."""
    readings = np.concatenate([log.gyro, log.accel], axis=1)
    finite = np.isfinite(readings).all(axis=1) & np.isfinite(log.time)
    beyond = finite & (np.abs(readings) > np.repeat([RATE_MAX, FORCE_MAX], 3)).any(axis=1)
    if beyond.sum() <= RARE * finite.sum():  # many are no spikes, but of another unit
        finite &= ~beyond
    readings, time = readings[finite], log.time[finite]
    if time.size < FEWEST:
        raise ValueError(f"{log.name}: {time.size} usable samples; at least {FEWEST} are required")
    steps = np.diff(time)
    apart = steps[steps > EXACT_S]
    least = max(EXACT_S, CLOSEST * float(np.median(apart))) if apart.size else EXACT_S
    latest = np.maximum.accumulate(time)
    forward = np.concatenate([[True], time[1:] > latest[:-1] + least])
    readings, time = readings[forward], time[forward]
    if time.size < FEWEST:
        raise ValueError(f"{log.name}: only {time.size} of its stamps go forward")
    same = (readings[1:] == readings[:-1]).all(axis=1)
    counted = {
        "missing": int((~finite).sum()),
        "stamps_back": int((~forward).sum()),
        "clock_back_ms": round(-1e3 * float(steps.min(initial=0.0))),
        "repeated": int(same.sum()),
        "saturated": int(_saturated(readings).sum()),
    }
    return replace(log, time=time, gyro=readings[:, :3], accel=readings[:, 3:]), counted


def _stuck(readings: Array, least: int) -> NDArray[np.bool_]:
    """Samples (T, 6) of an axis within a run of at least `least` equal readings while another of it moves.

    Or of all axes of a sensor while the other sensor moves.
    """
    stuck = np.zeros(readings.shape, bool)
    for first in (0, 3):
        sensor = readings[:, first : first + 3]
        steps = np.abs(np.diff(sensor, axis=0))
        resolution = [min(axis[axis > 0].tolist(), default=np.inf) for axis in steps.T]
        for k in range(3):
            if resolution[k] == np.inf:
                continue  # never another number: see `_still`
            edges = np.concatenate([[0], np.flatnonzero(steps[:, k] > 0) + 1, [len(sensor)]])
            long = np.flatnonzero(np.diff(edges) >= least)
            for start, end in zip(edges[long], edges[long + 1], strict=True):
                others = sensor[start:end].std(axis=0) > MOVES * np.array(resolution)
                stuck[start:end, first + k] = others.any()
        other = readings[:, 3 - first : 6 - first]
        edges = np.concatenate([[0], np.flatnonzero(steps.any(axis=1)) + 1, [len(sensor)]])
        long = np.flatnonzero(np.diff(edges) >= least)
        for start, end in zip(edges[long], edges[long + 1], strict=True):
            if not steps.any():
                continue  # never another number: see `_still`
            if np.linalg.norm(other[start:end].std(axis=0)) > (FORCE_MOVES if first == 0 else RATE_MOVES):
                stuck[start:end, first : first + 3] = True
    return stuck


def _saturated(readings: Array) -> NDArray[np.bool_]:
    """Samples within a run of equal readings at the least or largest value of an axis."""
    stuck = np.zeros(len(readings), bool)
    for values in readings.T:
        for extreme in (values.min(), values.max()):
            if extreme == np.median(values):
                continue  # an axis that hardly moves
            at = np.flatnonzero(values == extreme)
            for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
                if run.size >= STUCK:
                    stuck[run] = True
    return stuck


def _even(
    time: Array, readings: Array, grid: Array, rate_hz: float, period: float, corner: float | None
) -> Array:
    """Readings without a gap, (m, 6), on a grid of times within them."""
    if corner is None:
        return CubicSpline(time, readings)(grid)
    count = max(int((time[-1] - time[0]) / period) + 1, 4)
    fine = np.linspace(time[0], time[-1], count)
    values = CubicSpline(time, readings)(fine)
    fine_rate = (count - 1) / (fine[-1] - fine[0])
    width = (1 - PASS) * rate_hz / 2
    taps = int(np.ceil(3.3 * fine_rate / width)) | 1  # Hamming: −53 dB beyond that width
    kernel = np.asarray(firwin(taps, corner, fs=fine_rate), np.float64)
    half = taps // 2
    # Point reflection at the ends, so that no step is filtered there.
    head = 2 * values[0] - values[min(half, count - 1) : 0 : -1]
    tail = 2 * values[-1] - values[-2 : -2 - min(half, count - 1) : -1]
    padded = np.concatenate([head, values, tail])
    smooth = oaconvolve(padded, kernel[:, None], mode="same", axes=0)[len(head) : len(head) + count]
    return CubicSpline(fine, smooth)(grid)


def _levelling(force: Array) -> str:
    """The mount that brings a force (3,) to body z without a change of heading, as text."""
    return mount_text(matrix_from_quat(quat_from_roll_pitch(roll_pitch_of_up(force))))


def _vibration(accel: Array, rate_hz: float) -> float:
    """Root mean square of a specific force (T, 3) less its mean over a twentieth of a second."""
    fast = accel - uniform_filter1d(accel, max(round(VIBRATION_S * rate_hz), 1), axis=0)
    return float(np.sqrt((fast**2).sum(axis=1).mean()))


def _near(times: Array, grid: Array, period: float) -> NDArray[np.bool_]:
    """Which times of a grid (m,) are within a sample period of some of the times, in order."""
    ends = np.concatenate([[-np.inf], times, [np.inf]])
    after = np.searchsorted(ends, grid).clip(1)
    return np.minimum(ends[after] - grid, grid - ends[after - 1]) <= period


def _interpolated(track: Track, grid: Array) -> Array:
    """Readings on the grid (T, ·), NaN in gaps."""
    good = np.isfinite(track.values).all(axis=1) & np.isfinite(track.time)
    time, first = np.unique(track.time[good], return_index=True)
    if time.size < 2:
        return np.full((grid.size, track.values.shape[1]), np.nan)
    values = np.stack([np.interp(grid, time, column) for column in track.values[good][first].T], axis=1)
    after = np.clip(np.searchsorted(time, grid), 1, time.size - 1)
    known = (grid >= time[0] - EXACT_S) & (grid <= time[-1] + EXACT_S)
    known &= time[after] - time[after - 1] <= SENSOR_GAP_S
    return np.where(known[:, None], values, np.nan)


def _truth(log: Recording, grid: Array) -> tuple[dict[str, Array], float]:
    """Attitude, position and mark on the grid; NaN where not known. And the rate of the attitude."""
    out = {"quat": np.full((grid.size, 4), np.nan), "scored": np.zeros((grid.size, 1))}
    if log.quat is None or log.truth_time is None:
        return out, 0.0
    length = np.linalg.norm(log.quat, axis=1)
    good = np.isfinite(length) & (length > 0.5) & np.isfinite(log.truth_time)
    good[1:] &= np.diff(log.truth_time) > 0
    good &= (log.truth_time >= grid[0] - LONGEST_GAP_S) & (log.truth_time <= grid[-1] + LONGEST_GAP_S)
    time, quat = log.truth_time[good], log.quat[good]
    forward = np.diff(np.maximum.accumulate(time), prepend=-np.inf) > 0
    time, quat = time[forward], quat[forward]
    if time.size < 2:
        return out, 0.0
    after = np.clip(np.searchsorted(time, grid), 1, time.size - 1)
    apart = time[after] - time[after - 1]
    known = (grid >= time[0] - EXACT_S) & (grid <= time[-1] + EXACT_S) & (apart <= TRUTH_GAP_S)
    if known.any():
        inside = grid[known].clip(time[0], time[-1])
        found = Slerp(time, Rotation.from_quat(xyzw_from_wxyz(quat)))(inside).as_quat()
        out["quat"][known] = wxyz_from_xyzw(found)
    mark = np.ones(time.size) if log.marked is None else log.marked[good][forward].astype(float)
    out["scored"][:, 0] = known & (np.minimum(mark[after], mark[after - 1]) > 0.5)
    if log.position is not None:
        place = log.position[good][forward]
        columns = [np.interp(grid, time, column) for column in place.T]
        out["position"] = np.where(known[:, None], np.stack(columns, axis=1), np.nan)
    return out, float(1.0 / np.median(np.diff(time)))


def _dataset(log: Recording, even: Array, others: dict[str, Array], rate_hz: float) -> xr.Dataset:
    arrays = {"gyro": even[:, :3], "accel": even[:, 3:]} | others
    scored = arrays.pop("scored")[:, 0] > 0.5
    variables = {
        name: (
            ("flight", "time", MEASURED[name].dim),
            values[None],
            {"units": MEASURED[name].units, "long_name": MEASURED[name].long_name},
        )
        for name, values in arrays.items()
    }
    steps = len(even)
    return xr.Dataset(
        {**variables, "scored": (("flight", "time"), scored[None], {"long_name": "marked for scoring"})},
        coords={
            "flight": [0],
            "time": ("time", np.arange(steps) / rate_hz, {"units": "s"}),
            "axis": LABELS["axis"],
            "quat_axis": LABELS["quat_axis"],
            "valid_steps": ("flight", [steps]),
            "end_reason": ("flight", np.array([""], dtype=object)),
        },
        attrs={"rate_hz": rate_hz, "duration_s": steps / rate_hz, "source": log.name},
    )
