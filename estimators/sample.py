"""What every compiled filter does with a sample before and after its own equations.

A filter keeps one row of float64 per vehicle. The first `COMMON` columns belong to this module; the filter's
own state follows from column `COMMON` on.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

SKIPPED, AGE, RATE_X, RATE_Y, RATE_Z = range(5)
COMMON = 5
"""Columns of a state row: samples skipped, age of the last good rate [s] (infinite at first), that rate."""

HOLD_S = 0.1
"""A missing gyroscope sample is replaced by the last good one for this long [s], and after that by zero."""


@njit
def usable(state, dt, gyro, accel, i, t):
    """The sample to use for one that may be missing: rate held, specific force zero for "no correction".

    Missing is what is not finite, and a specific force of exactly zero, which no working sensor on a vehicle
    under thrust gives. A rate of exactly zero is a good measurement.

    Args:
        state: The vehicle's row; its common columns are updated.
        dt: Sample period [s].
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
        i: Flight.
        t: Sample.

    Returns:
        Rate x, y, z and specific force x, y, z.
    """
    gx, gy, gz = gyro[i, t, 0], gyro[i, t, 1], gyro[i, t, 2]
    ax, ay, az = accel[i, t, 0], accel[i, t, 1], accel[i, t, 2]
    rate_found = math.isfinite(gx) and math.isfinite(gy) and math.isfinite(gz)
    force = ax * ax + ay * ay + az * az
    force_found = math.isfinite(force) and force > 0.0
    if rate_found:
        state[AGE] = 0.0
        state[RATE_X], state[RATE_Y], state[RATE_Z] = gx, gy, gz
    else:
        state[AGE] += dt
        held = 1.0 if state[AGE] <= HOLD_S else 0.0
        gx, gy, gz = held * state[RATE_X], held * state[RATE_Y], held * state[RATE_Z]
    if not force_found:
        ax = ay = az = 0.0
    if not (rate_found and force_found):
        state[SKIPPED] += 1.0
    return gx, gy, gz, ax, ay, az


@njit
def usable_between(state, dt, gyro, accel, i, t):
    """As `usable`, with the mean of this rate and the last: the trapezoidal rule from sample to sample."""
    known = state[AGE] <= HOLD_S
    last_x, last_y, last_z = state[RATE_X], state[RATE_Y], state[RATE_Z]
    gx, gy, gz, ax, ay, az = usable(state, dt, gyro, accel, i, t)
    if known:
        return 0.5 * (last_x + gx), 0.5 * (last_y + gy), 0.5 * (last_z + gz), ax, ay, az
    return gx, gy, gz, ax, ay, az


@njit
def atan2_core(y, x):
    """atan2 to one unit in the last place, compiled inline: twice as fast as a call of the C library.

    Rational approximation of Cephes (S. Moshier, `atan.c`) on [0, tan π/8] after a turn by 0, 45 or 90°.
    """
    across, along = abs(y), abs(x)
    if across > 2.414213562373095 * along:
        top, bottom, turn = -along, across, 0.5 * math.pi
    elif across > 0.41421356237309503 * along:
        top, bottom, turn = across - along, across + along, 0.25 * math.pi
    else:
        top, bottom, turn = across, along, 0.0
    r = top / bottom if bottom != 0.0 else 0.0
    z = r * r
    p = -8.750608600031904e-1 * z - 1.615753718733365e1
    p = ((p * z - 7.500855792314705e1) * z - 1.228866684490136e2) * z - 6.485021904942025e1
    q = ((z + 2.485846490142306e1) * z + 1.650270098316989e2) * z + 4.328810604912903e2
    q = (q * z + 4.853903996359137e2) * z + 1.945506571482614e2
    angle = turn + (r + r * z * p / q)
    if x < 0.0:
        angle = math.pi - angle
    return angle if y >= 0.0 else -angle


@njit
def roll_pitch_core(qw, qx, qy, qz):
    """Roll and pitch of a quaternion [rad], without the yaw that `euler_core` also works out."""
    across = 2.0 * (qy * qz + qw * qx)
    up = qw * qw - qx * qx - qy * qy + qz * qz
    return atan2_core(across, up), atan2_core(2.0 * (qw * qy - qx * qz), math.sqrt(across * across + up * up))


@njit
def tilt_of_force_core(ax, ay, az):
    """Roll and pitch at which gravity alone would give this specific force [rad]."""
    return atan2_core(ay, az), atan2_core(-ax, math.sqrt(ay * ay + az * az))


@njit
def wrap_core(angle):
    """The same angle within ±π, for one within ±3π [rad]."""
    if angle > math.pi:
        return angle - 2.0 * math.pi
    if angle < -math.pi:
        return angle + 2.0 * math.pi
    return angle


@njit
def record(row, flight, t, roll, pitch, out, target, squared_error):
    """Store an estimate, add its squared error to the row's sum, or both: whichever arrays have any samples.

    Args:
        row: Row of `out` and `squared_error`: a parameter set on a flight.
        flight: Row of `target`.
        t: Sample.
        roll: Estimate [rad].
        pitch: Estimate [rad].
        out: (rows, T, 2), or (rows, 0, 2) to store nothing.
        target: True roll and pitch (n, T, 2), or (n, 0, 2) to score nothing; NaN samples are not scored.
        squared_error: (rows,) [rad²].
    """
    if out.shape[1] > 0:
        out[row, t, 0] = roll
        out[row, t, 1] = pitch
    if target.shape[1] > 0:
        d_roll = wrap_core(roll - target[flight, t, 0])
        d_pitch = pitch - target[flight, t, 1]
        error = d_roll * d_roll + d_pitch * d_pitch
        if math.isfinite(error):
            squared_error[row] += error


@njit(cache=True, nogil=True)
def clean(states, dt, gyro, accel, gyro_out, accel_out, between):
    """`usable` or `usable_between` over whole sequences, for estimators that are not compiled here.

    Args:
        states: (n, COMMON), updated.
        dt: Sample period [s].
        gyro: (n, T, 3) [rad/s].
        accel: (n, T, 3) [m/s²].
        gyro_out: (n, T, 3), written.
        accel_out: (n, T, 3), written; zero where it cannot be used.
        between: Whether rates are to be the mean of this sample and the last.
    """
    for i in range(gyro.shape[0]):
        for t in range(gyro.shape[1]):
            if between:
                gx, gy, gz, ax, ay, az = usable_between(states[i], dt, gyro, accel, i, t)
            else:
                gx, gy, gz, ax, ay, az = usable(states[i], dt, gyro, accel, i, t)
            gyro_out[i, t, 0], gyro_out[i, t, 1], gyro_out[i, t, 2] = gx, gy, gz
            accel_out[i, t, 0], accel_out[i, t, 1], accel_out[i, t, 2] = ax, ay, az


def fresh(rows: int, size: int = 0) -> NDArray[np.float64]:
    """State rows before the first sample, (rows, COMMON + size), the filter's own columns zero."""
    states = np.zeros((rows, COMMON + size))
    states[:, AGE] = np.inf
    return states
