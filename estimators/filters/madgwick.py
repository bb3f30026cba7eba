"""Madgwick's gradient-descent filter, without magnetometer.

S. Madgwick, A. Harrison, R. Vaidyanathan, "Estimation of IMU and MARG orientation using a gradient descent
algorithm", ICORR 2011. With f the difference of the predicted and the measured direction of the specific
force (eq. 25) and J its Jacobian (eq. 26):

    q̇ = ½ q ⊗ (0, ω) − β Jᵀf / ‖Jᵀf‖
"""

import math

import numpy as np

from quadsim.rotation import normalize_core
from quadsim.runs.compiled import njit

from .driver import CompiledFilter
from .inline_math import direction_core, multiply, put, roll_pitch_core
from .samples import reacquire, run_vehicles

RECORD = np.dtype([("quat", "f8", 4), ("tilt_variance", "f8")])
"""State; the variance is that of the tilt error caused by gaps [rad²]."""


@njit(error_model="numpy")
def descent(qw, qx, qy, qz, ax, ay, az):
    """Return the steepest ascent Jᵀf / ‖Jᵀf‖ at q (zero if gradient or force is zero), and ‖f‖."""
    ax, ay, az = direction_core(ax, ay, az)
    fx = 2.0 * (qx * qz - qw * qy) - ax
    fy = 2.0 * (qw * qx + qy * qz) - ay
    fz = 2.0 * (0.5 - qx * qx - qy * qy) - az
    w = -2.0 * qy * fx + 2.0 * qx * fy
    x = 2.0 * qz * fx + 2.0 * qw * fy - 4.0 * qx * fz
    y = -2.0 * qw * fx + 2.0 * qz * fy - 4.0 * qy * fz
    z = 2.0 * qx * fx + 2.0 * qy * fy
    length = math.sqrt(w * w + x * x + y * y + z * z)
    known = length > 0.0 and (ax != 0.0 or ay != 0.0 or az != 0.0)
    scale = 1.0 / length if known else 0.0
    return w * scale, x * scale, y * scale, z * scale, math.sqrt(fx * fx + fy * fy + fz * fz)


@njit(inline="always")
def step(s, p, sample):
    """Process a sample or sequences; see `driver`."""
    dt = sample.dt
    gx, gy, gz = sample.gyro
    ax, ay, az = sample.accel
    qw, qx, qy, qz = s.quat
    dw, dx, dy, dz = multiply(s.quat, (0.0, 0.5 * gx, 0.5 * gy, 0.5 * gz))
    fw, fx, fy, fz, error = descent(qw, qx, qy, qz, ax, ay, az)
    share, s.tilt_variance = reacquire(s.tilt_variance, sample)
    beta = max(p.beta, 0.5 * share * error / dt)
    w, x = qw + (dw - beta * fw) * dt, qx + (dx - beta * fx) * dt
    y, z = qy + (dy - beta * fy) * dt, qz + (dz - beta * fz) * dt
    put(s.quat, normalize_core(w, x, y, z))
    return roll_pitch_core(s.quat)


@njit(cache=True, nogil=True, error_model="numpy")
def run(states, samples, params, dt, gyro, accel, rotor_vel, out):
    """Process a sample or sequences; see `driver`."""
    run_vehicles(step, states, samples, params, dt, gyro, accel, rotor_vel, out)


class Madgwick(CompiledFilter):
    """The filter of n vehicles."""

    record, run = RECORD, staticmethod(run)
