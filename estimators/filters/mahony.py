"""Mahony's explicit complementary filter with bias estimation.

R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special orthogonal group", IEEE
Transactions on Automatic Control 53(5), 2008, eq. 48. With v̂ the predicted and a the measured direction of
the specific force in body axes, and e = a × v̂:

    ḃ = −k_I e,    q̇ = ½ q ⊗ (0, ω − b̂ + k_P e)
"""

import numpy as np

from quadsim.rotation import normalize_core, rotate_inverse_core
from quadsim.runs.compiled import njit

from .driver import CompiledFilter
from .inline_math import direction_core, multiply, put, roll_pitch_core
from .samples import reacquire, run_vehicles

RECORD = np.dtype([("quat", "f8", 4), ("gyro_bias", "f8", 3), ("tilt_variance", "f8")])
"""State; the variance is that of the tilt error caused by gaps [rad²]."""


@njit(inline="always")
def step(s, p, sample):
    """Process a sample or sequences; see `driver`."""
    dt, k_i = sample.dt, p.k_i
    gx, gy, gz = sample.gyro
    qw, qx, qy, qz = s.quat
    bx, by, bz = s.gyro_bias
    ax, ay, az = direction_core(sample.accel[0], sample.accel[1], sample.accel[2])
    vx, vy, vz = rotate_inverse_core(qw, qx, qy, qz, 0.0, 0.0, 1.0)
    ex, ey, ez = ay * vz - az * vy, az * vx - ax * vz, ax * vy - ay * vx
    bx, by, bz = bx - k_i * ex * dt, by - k_i * ey * dt, bz - k_i * ez * dt
    share, s.tilt_variance = reacquire(s.tilt_variance, sample)
    k_p = max(p.k_p, share / dt)
    rate = gx - bx + k_p * ex, gy - by + k_p * ey, gz - bz + k_p * ez
    dw, dx, dy, dz = multiply(s.quat, (0.0, *rate))
    h = 0.5 * dt
    put(s.quat, normalize_core(qw + h * dw, qx + h * dx, qy + h * dy, qz + h * dz))
    put(s.gyro_bias, (bx, by, bz))
    return roll_pitch_core(s.quat)


@njit(cache=True, nogil=True, error_model="numpy")
def run(states, samples, params, dt, gyro, accel, rotor_vel, out):
    """Process a sample or sequences; see `driver`."""
    run_vehicles(step, states, samples, params, dt, gyro, accel, rotor_vel, out)


class Mahony(CompiledFilter):
    """The filter of n vehicles."""

    record, run = RECORD, staticmethod(run)
