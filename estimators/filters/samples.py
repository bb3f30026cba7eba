"""What every compiled filter does with a sample before and after its own equations.

A filter keeps one row of float64 per vehicle. The first `COMMON` columns belong to this module; the filter's
own state follows from column `COMMON` on.
"""

import math

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.compiled import njit

from ..sanitise import force_usable, rate_usable, within
from .inline_math import wrap_core

SKIPPED, AGE, RATE_X, RATE_Y, RATE_Z, TRUSTED = range(6)
COMMON = 6
"""Columns of a state row: samples skipped, age of the last good rate [s] (infinite at first), that rate, and
for how long there have been good ones [s]."""

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

REGAIN_NOISE = 0.2
"""Noise density of the tilt that the accelerometer of a flying vehicle shows [rad √s]."""


@njit
def turned_unseen(age):
    """Variance of the turn since the last good rate that holding it has not followed [rad²].

    The standard deviation grows with the square of time at first, while the rate is still about the last, and
    later with time.

    Args:
        age: Time since then [s].
    """
    sigma = GAP_RATE * age * age / (age + HOLD_S)
    return sigma * sigma


@njit(error_model="numpy")
def regain(doubt, unseen, ax, ay, az, dt):
    """What a filter of fixed gain does about a gap: the share of the tilt's error that a sample takes back.

    A Kalman filter of that error alone. A filter with a covariance of its own adds `unseen` to it instead.

    Args:
        doubt: Variance of the tilt that gaps have left [rad²].
        unseen: What is added to it now [rad²].
        ax: Specific force, zero if it is missing, like the next two.
        ay: ...
        az: ...
        dt: Sample period [s].

    Returns:
        The share, and the variance that is left [rad²].
    """
    doubt += unseen
    found = 1.0 if ax != 0.0 or ay != 0.0 or az != 0.0 else 0.0
    share = found * doubt / (doubt + REGAIN_NOISE * REGAIN_NOISE / dt)
    return share, doubt - share * doubt


@njit
def usable(state, dt, gyro, accel, i, t):
    """The sample to use for one that may be missing: rate held, specific force zero for "no correction".

    A rate that jumps as no vehicle can turn is taken for missing, until it has lasted.

    Args:
        state: The vehicle's row; its common columns are updated.
        dt: Sample period [s].
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
        i: Flight.
        t: Sample.

    Returns:
        Rate x, y, z, specific force x, y, z, and the variance of what the vehicle turned unseen since the
        last sample [rad²].
    """
    gx, gy, gz = gyro[i, t, 0], gyro[i, t, 1], gyro[i, t, 2]
    ax, ay, az = accel[i, t, 0], accel[i, t, 1], accel[i, t, 2]
    doubtful = state[AGE] < min(HOLD_S, state[TRUSTED])
    step = max(RATE_STEP, ACCELERATION_MAX * dt) if doubtful else math.inf
    steady = within(gx - state[RATE_X], gy - state[RATE_Y], gz - state[RATE_Z], step)
    rate_found, force_found, unseen = steady and rate_usable(gx, gy, gz), force_usable(ax, ay, az), 0.0
    if rate_found:
        state[AGE] = 0.0
        state[TRUSTED] += dt
        state[RATE_X], state[RATE_Y], state[RATE_Z] = gx, gy, gz
    else:
        unseen = turned_unseen(state[AGE] + dt) - turned_unseen(state[AGE]) if state[AGE] < math.inf else 0.0
        state[AGE] += dt
        held = 1.0 if state[AGE] <= HOLD_S else 0.0
        gx, gy, gz = held * state[RATE_X], held * state[RATE_Y], held * state[RATE_Z]
    if not force_found:
        ax = ay = az = 0.0
    if not (rate_found and force_found):
        state[SKIPPED] += 1.0
    return gx, gy, gz, ax, ay, az, unseen


@njit
def usable_between(state, dt, gyro, accel, i, t):
    """As `usable`, with the mean of this rate and the last: the trapezoidal rule from sample to sample."""
    known = state[AGE] <= HOLD_S
    last_x, last_y, last_z = state[RATE_X], state[RATE_Y], state[RATE_Z]
    gx, gy, gz, ax, ay, az, unseen = usable(state, dt, gyro, accel, i, t)
    if known:
        return 0.5 * (last_x + gx), 0.5 * (last_y + gy), 0.5 * (last_z + gz), ax, ay, az, unseen
    return gx, gy, gz, ax, ay, az, unseen


@njit
def sample_of(between, state, dt, gyro, accel, i, t):
    """`usable_between` or `usable`."""
    if between:
        return usable_between(state, dt, gyro, accel, i, t)
    return usable(state, dt, gyro, accel, i, t)


@njit
def square_of_error(roll, pitch, true_roll, true_pitch):
    """Squared error of roll and of pitch [rad²], π² each if the estimate is no number; 0 without truth."""
    d_roll, d_pitch = wrap_core(roll - true_roll), pitch - true_pitch
    total = d_roll * d_roll + d_pitch * d_pitch
    known = true_roll == true_roll and true_pitch == true_pitch
    return (total if total <= WORST else WORST) if known else 0.0


@njit(forceinline=True, error_model="numpy")
def by_rows(advance, between, states, params, dt, gyro, accel, out):
    """Run every row over all its samples: the whole of a filter's `sequence`.

    Args:
        advance: The filter's equations, as described in `filters`.
        between: Whether rates are to be the mean of this sample and the last.
        states: (p·n, COMMON + size), updated.
        params: (p, k).
        dt: Sample period [s].
        gyro: (n, T, 3) [rad/s].
        accel: (n, T, 3) [m/s²].
        out: Roll and pitch (p·n, T, 2) [rad], written.
    """
    n, steps = gyro.shape[:2]
    s, p = np.empty((states.shape[1] - COMMON, 1)), np.empty((params.shape[1], 1))
    for row in range(states.shape[0]):
        i = row % n
        s[:, 0], p[:, 0] = states[row, COMMON:], params[row // n]
        for t in range(steps):
            gx, gy, gz, ax, ay, az, unseen = sample_of(between, states[row], dt, gyro, accel, i, t)
            out[row, t, 0], out[row, t, 1] = advance(s, p, 0, dt, gx, gy, gz, ax, ay, az, unseen)
        states[row, COMMON:] = s[:, 0]


@njit(forceinline=True, error_model="numpy")
def by_lanes(advance, lanes, between, states, params, dt, gyro, accel, target, squared_error):
    """Sum the squared error of every parameter set on every flight: the whole of a filter's `score`.

    `lanes` sets take each sample together, their states side by side: the compiler makes one vector
    instruction of what they do alike, which is several times as fast as one set after the other.

    Args:
        advance: The filter's equations, as described in `filters`.
        lanes: How many sets to take together, a constant.
        between: Whether rates are to be the mean of this sample and the last.
        states: (p·n, COMMON + size) to start from.
        params: (p, k).
        dt: Sample period [s].
        gyro: (n, T, 3) [rad/s].
        accel: (n, T, 3) [m/s²].
        target: True roll and pitch (n, T, 2) [rad]; samples that are NaN are not scored.
        squared_error: Sums (p, n) [rad²], written.
    """
    n, steps, sets = gyro.shape[0], gyro.shape[1], params.shape[0]
    s, p = np.empty((states.shape[1] - COMMON, lanes)), np.empty((params.shape[1], lanes))
    total = np.empty(lanes)
    for first in range(0, sets, lanes):
        for i in range(n):
            for k in range(lanes):
                chosen = min(first + k, sets - 1)
                s[:, k], p[:, k] = states[chosen * n + i, COMMON:], params[chosen]
                total[k] = 0.0
            common = states[first * n + i]
            for t in range(steps):
                gx, gy, gz, ax, ay, az, unseen = sample_of(between, common, dt, gyro, accel, i, t)
                for k in range(lanes):
                    roll, pitch = advance(s, p, k, dt, gx, gy, gz, ax, ay, az, unseen)
                    total[k] += square_of_error(roll, pitch, target[i, t, 0], target[i, t, 1])
            for k in range(min(lanes, sets - first)):
                squared_error[first + k, i] = total[k]


@njit(cache=True, nogil=True)
def sanitise(states, dt, gyro, accel, gyro_out, accel_out, unseen_out, between):
    """`usable` or `usable_between` over whole sequences, for estimators that are not compiled here.

    Args:
        states: (n, COMMON), updated.
        dt: Sample period [s].
        gyro: (n, T, 3) [rad/s].
        accel: (n, T, 3) [m/s²].
        gyro_out: (n, T, 3), written.
        accel_out: (n, T, 3), written; zero where it cannot be used.
        unseen_out: (n, T), written: variance of what was turned unseen [rad²].
        between: Whether rates are to be the mean of this sample and the last.
    """
    for i in range(gyro.shape[0]):
        for t in range(gyro.shape[1]):
            gx, gy, gz, ax, ay, az, unseen_out[i, t] = sample_of(between, states[i], dt, gyro, accel, i, t)
            gyro_out[i, t, 0], gyro_out[i, t, 1], gyro_out[i, t, 2] = gx, gy, gz
            accel_out[i, t, 0], accel_out[i, t, 1], accel_out[i, t, 2] = ax, ay, az


def fresh(rows: int, size: int = 0) -> NDArray[np.float64]:
    """State rows before the first sample, (rows, COMMON + size), the filter's own columns zero."""
    states = np.zeros((rows, COMMON + size))
    states[:, AGE] = np.inf
    return states
