"""What every compiled filter does with a sample before and after its own equations.

The state of a vehicle is one record of float64: the filter's own fields, then those of `SAMPLES`, which
belong to this module. Where `by_lanes` vectorises a filter, its fields have one more axis, the lane: length 1
in that record, and `LANES` where so many parameter sets take a sample together.
"""

import math
from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.compiled import njit

from ..sanitise import force_usable, rate_usable, speed_usable, within
from .inline_math import wrap_core

SAMPLES = np.dtype(
    [
        ("skipped", "f8"),  # samples that were missing in part or whole
        ("age", "f8"),  # of the last good rate [s]; infinite before the first
        ("rate", "f8", 3),  # that rate [rad/s]
        ("good_time", "f8"),  # for which there have been good ones [s]
    ]
)
"""The common fields of a filter's state."""

LANES = 16
"""Parameter sets that `by_lanes` takes together."""

WORST = 2.0 * math.pi**2
"""Squared error of an estimate that is 180° off in roll and in pitch, or no number [rad²]."""
HOLD_S = 0.1
"""A missing gyroscope sample is replaced by the last good one for this long [s], and after that by zero."""
RATE_STEP, ACCELERATION_MAX = 10.0, 2000.0
"""Largest change of a rate from the last good sample: the larger of this many rad/s, and what so many rad/s²
make in a sample. What differs by more is missing, for `HOLD_S`, or as long as there had been good ones."""
GAP_RATE = 2.0
"""Standard deviation of the rate at which a vehicle turns unseen in a gap longer than `HOLD_S` [rad/s]."""

ROTORS_STOPPED = 1.0
"""Rotor speed below which rotors do not turn: the root of the sum of squares [rad/s]."""

REACQUISITION_NOISE = 0.2
"""Noise density of the tilt that the accelerometer of a flying vehicle shows [rad √s]."""


class Sample(NamedTuple):
    """A sanitised sample of one vehicle, in compiled code."""

    gyro: tuple[float, float, float]
    """Body rate [rad/s]."""
    accel: tuple[float, float, float]
    """Specific force [m/s²]; zero where it is missing, which asks for no correction."""
    unseen: float
    """Variance of the unmeasured turn since the last sample [rad²]; zero unless a rate is missing."""
    dt: float
    """Sample period [s]."""


def lanes_of(fields: np.dtype, lanes: int = 1) -> np.dtype:
    """The record with one more axis at the end of every field."""
    return np.dtype([(name, "f8", (*fields[name].shape, lanes)) for name in fields.names or ()])


def parameter_record(names: Iterable[str]) -> np.dtype:
    """The record of a filter's parameters."""
    return np.dtype([(name, "f8") for name in names])


@cache
def record_of(own: np.dtype) -> np.dtype:
    """The whole record, one object for each filter: Numba compares others field by field in every call."""
    return np.dtype([*own.descr, *SAMPLES.descr])


def initial_states(rows: int, own: np.dtype | None = None) -> NDArray[np.void]:
    """States before the first sample, (rows,), the filter's own fields zero."""
    states = np.zeros(rows, SAMPLES if own is None else record_of(own))
    states["age"] = np.inf
    return states


@njit
def turned_unseen(age):
    """Variance of the turn since the last good rate that its repetition does not predict [rad²].

    The standard deviation grows with the square of time at first, while the rate is still about the last, and
    later with time.

    Args:
        age: Time since then [s].
    """
    sigma = GAP_RATE * age * age / (age + HOLD_S)
    return sigma * sigma


@njit(error_model="numpy")
def reacquire(tilt_variance, sample):
    """What a filter of fixed gain does about a gap: the share of the tilt's error that a sample takes back.

    A Kalman filter of that error alone. A filter with a covariance of its own adds `unseen` to it instead.

    Args:
        tilt_variance: Variance of the tilt that gaps have left [rad²].
        sample: The sample.

    Returns:
        The share, and the variance that is left [rad²].
    """
    variance = tilt_variance + sample.unseen
    ax, ay, az = sample.accel
    found = 1.0 if ax != 0.0 or ay != 0.0 or az != 0.0 else 0.0
    share = found * variance / (variance + REACQUISITION_NOISE * REACQUISITION_NOISE / sample.dt)
    return share, variance - share * variance


@njit
def sanitise_sample(state, dt, gyro, accel, i, t):
    """The `Sample` to use for one that may be missing: the last good rate, specific force zero.

    A rate that jumps as no vehicle can turn is taken for missing, until it has lasted.

    Args:
        state: The vehicle's record; its common fields are updated.
        dt: Sample period [s].
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
        i: Flight.
        t: Sample.
    """
    gx, gy, gz = gyro[i, t, 0], gyro[i, t, 1], gyro[i, t, 2]
    ax, ay, az = accel[i, t, 0], accel[i, t, 1], accel[i, t, 2]
    last = state.rate
    doubtful = state.age < min(HOLD_S, state.good_time)
    step = max(RATE_STEP, ACCELERATION_MAX * dt) if doubtful else math.inf
    smooth = within(gx - last[0], gy - last[1], gz - last[2], step)
    rate_found, force_found, unseen = smooth and rate_usable(gx, gy, gz), force_usable(ax, ay, az), 0.0
    if rate_found:
        state.age = 0.0
        state.good_time += dt
        last[0], last[1], last[2] = gx, gy, gz
    else:
        unseen = turned_unseen(state.age + dt) - turned_unseen(state.age) if state.age < math.inf else 0.0
        state.age += dt
        share = 1.0 if state.age <= HOLD_S else 0.0
        gx, gy, gz = share * last[0], share * last[1], share * last[2]
    if not force_found:
        ax = ay = az = 0.0
    if not (rate_found and force_found):
        state.skipped += 1.0
    return Sample((gx, gy, gz), (ax, ay, az), unseen, dt)


@njit
def sum_of_squares(rotor_vel, i, t):
    """Σ ω² of the rotors of one sample [rad²/s²]; zero where a speed is missing, or the rotors stand still.

    Args:
        rotor_vel: Rotor speeds (n, T, rotors) [rad/s].
        i: Flight.
        t: Sample.
    """
    total = 0.0
    for k in range(rotor_vel.shape[2]):
        if not speed_usable(rotor_vel[i, t, k]):
            return 0.0
        total += rotor_vel[i, t, k] ** 2
    return total if total >= ROTORS_STOPPED * ROTORS_STOPPED else 0.0


@njit
def sanitise_midpoint(state, dt, gyro, accel, i, t):
    """As `sanitise_sample`, with the mean of this rate and the last: the trapezoidal rule between samples."""
    known = state.age <= HOLD_S
    last_x, last_y, last_z = state.rate[0], state.rate[1], state.rate[2]
    sample = sanitise_sample(state, dt, gyro, accel, i, t)
    gx, gy, gz = sample.gyro
    if known:
        gx, gy, gz = 0.5 * (last_x + gx), 0.5 * (last_y + gy), 0.5 * (last_z + gz)
    return Sample((gx, gy, gz), sample.accel, sample.unseen, dt)


@njit
def sample_of(midpoint, state, dt, gyro, accel, i, t):
    """`sanitise_midpoint` or `sanitise_sample`."""
    if midpoint:
        return sanitise_midpoint(state, dt, gyro, accel, i, t)
    return sanitise_sample(state, dt, gyro, accel, i, t)


@njit
def square_of_error(roll, pitch, true_roll, true_pitch):
    """Squared error of roll and of pitch [rad²], π² each if the estimate is no number; 0 without truth."""
    d_roll, d_pitch = wrap_core(roll - true_roll), wrap_core(pitch - true_pitch)
    total = d_roll * d_roll + d_pitch * d_pitch
    known = true_roll == true_roll and true_pitch == true_pitch
    return (total if total <= WORST else WORST) if known else 0.0


@njit(forceinline=True, error_model="numpy")
def by_rows(advance, midpoint, states, params, dt, gyro, accel, out):
    """Run every record over all its samples: the whole of a filter's `sequence`.

    Args:
        advance: The filter's equations, as described in `filters.algorithm`.
        midpoint: Whether rates are to be the mean of this sample and the last.
        states: Records (p·n,), updated.
        params: Records (p,).
        dt: Sample period [s].
        gyro: (n, T, 3) [rad/s].
        accel: (n, T, 3) [m/s²].
        out: Roll and pitch (p·n, T, 2) [rad], written.
    """
    n, steps = gyro.shape[:2]
    for row in range(states.shape[0]):
        s, p, i = states[row], params[row // n], row % n
        for t in range(steps):
            sample = sample_of(midpoint, s, dt, gyro, accel, i, t)
            out[row, t, 0], out[row, t, 1] = advance(s, p, 0, sample)


@njit(forceinline=True, error_model="numpy")
def by_lanes(advance, midpoint, work, states, params, dt, flights):
    """Sum the squared error of every parameter set on every flight: the whole of a filter's `score`.

    `LANES` sets take each sample together, their states side by side: the compiler makes one vector
    instruction of what they do alike, which is several times as fast as one set after the other.

    Args:
        advance: The filter's equations, as described in `filters.algorithm`.
        midpoint: Whether rates are to be the mean of this sample and the last.
        work: Scratch: records (1,) of the filter's own state and of its parameters, each in `LANES` lanes.
        states: Records (p·n,) to start from.
        params: Records (p,).
        dt: Sample period [s].
        flights: gyro [rad/s] and accel [m/s²] (n, T, 3), and true roll and pitch (n, T, 2) [rad]; samples
            whose truth is NaN are not scored.

    Returns:
        Sums (p, n) [rad²].
    """
    gyro, accel, target = flights
    n, steps, sets = gyro.shape[0], gyro.shape[1], params.shape[0]
    s, p = work[0][0], work[1][0]
    s_lanes = work[0].view(np.float64).reshape(-1, LANES)
    p_lanes = work[1].view(np.float64).reshape(-1, LANES)
    rows = states.view(np.float64).reshape(states.shape[0], -1)[:, : s_lanes.shape[0]]
    values = params.view(np.float64).reshape(sets, -1)
    total, squared_error = np.empty(LANES), np.empty((sets, n))
    for first in range(0, sets, LANES):
        for i in range(n):
            for k in range(LANES):
                chosen = min(first + k, sets - 1)
                s_lanes[:, k], p_lanes[:, k] = rows[chosen * n + i], values[chosen]
                total[k] = 0.0
            common = states[first * n + i]
            for t in range(steps):
                sample = sample_of(midpoint, common, dt, gyro, accel, i, t)
                for k in range(LANES):
                    roll, pitch = advance(s, p, k, sample)
                    total[k] += square_of_error(roll, pitch, target[i, t, 0], target[i, t, 1])
            for k in range(min(LANES, sets - first)):
                squared_error[first + k, i] = total[k]
    return squared_error


@njit(cache=True, nogil=True)
def sanitise(states, dt, gyro, accel, midpoint):
    """Every sample of whole sequences sanitised, for estimators that are not compiled here.

    Args:
        states: Records (n,) of `SAMPLES`, updated.
        dt: Sample period [s].
        gyro: (n, T, 3) [rad/s].
        accel: (n, T, 3) [m/s²].
        midpoint: Whether rates are to be the mean of this sample and the last.

    Returns:
        Rate and specific force (n, T, 3), zero where it cannot be used, and the variance of what was turned
        unseen (n, T) [rad²].
    """
    rate, force, unseen = np.empty_like(gyro), np.empty_like(accel), np.empty(gyro.shape[:2])
    for i in range(gyro.shape[0]):
        for t in range(gyro.shape[1]):
            sample = sample_of(midpoint, states[i], dt, gyro, accel, i, t)
            for k in range(3):
                rate[i, t, k], force[i, t, k] = sample.gyro[k], sample.accel[k]
            unseen[i, t] = sample.unseen
    return rate, force, unseen
