"""Complementary filters: roll and pitch, each on its own.

    θ̂ ← γ (θ̂ + ω dt) + (1 − γ) θ_acc

The adaptive one trusts the accelerometer more while the vehicle hardly turns: for ‖ω‖ below `SLOW_RATE` the
weight 1 − γ grows by k_a |θ̂ − θ_acc|.
"""

import numpy as np

from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.compiled import njit

from .algorithm import Algorithm, Array, Parameter, Records
from .inline_math import tilt_of_force_core, wrap_core
from .samples import reacquire, run_all

SLOW_RATE = 0.1
"""Body rate below which the adaptive filter trusts the accelerometer more [rad/s]."""

STATE = np.dtype([("roll", "f8"), ("pitch", "f8"), ("tilt_variance", "f8")])
"""Angles [rad], and the variance of the tilt that gaps have left [rad²]."""

_GAMMA = Parameter(0.998, 0.9, 1.0 - 1e-6, "one-minus-log", maximum=1.0, per_sample="memory")
PARAMETERS = {"gamma": _GAMMA}
ADAPTIVE_PARAMETERS = PARAMETERS | {"k_a": Parameter(0.01, 1e-5, 1.0, per_sample="weight")}


@njit(error_model="numpy")
def mix(s, gamma, k_a, sample):
    """The equations above."""
    gx, gy, gz = sample.gyro
    ax, ay, az = sample.accel
    roll, pitch = s.roll + gx * sample.dt, s.pitch + gy * sample.dt
    acc_roll, acc_pitch = tilt_of_force_core(ax, ay, az)
    d_roll, d_pitch = wrap_core(acc_roll - roll), acc_pitch - pitch
    more = k_a if gx * gx + gy * gy + gz * gz < SLOW_RATE * SLOW_RATE else 0.0
    found = 1.0 if ax != 0.0 or ay != 0.0 or az != 0.0 else 0.0
    share, s.tilt_variance = reacquire(s.tilt_variance, sample)
    weight = max(1.0 - gamma, share)
    roll += found * min(weight + more * abs(d_roll), 1.0) * d_roll
    pitch += found * min(weight + more * abs(d_pitch), 1.0) * d_pitch
    s.roll, s.pitch = wrap_core(roll), pitch
    return s.roll, pitch


@njit
def step(s, p, sample):
    """See `algorithm`."""
    return mix(s, p.gamma, 0.0, sample)


@njit
def step_adaptive(s, p, sample):
    """See `algorithm`."""
    return mix(s, p.gamma, p.k_a, sample)


@njit(cache=True, nogil=True)
def run(states, params, dt, gyro, accel, rotor_vel, out):
    """See `algorithm`."""
    run_all(step, states, params, dt, gyro, accel, rotor_vel, out)


@njit(cache=True, nogil=True)
def run_adaptive(states, params, dt, gyro, accel, rotor_vel, out):
    """See `algorithm`."""
    run_all(step_adaptive, states, params, dt, gyro, accel, rotor_vel, out)


def _start(states: Records, quat: Array, known: bool, params: Records) -> None:
    states["roll"], states["pitch"] = roll_pitch_from_quat(quat).T


COMPLEMENTARY = Algorithm("complementary", PARAMETERS, STATE, run, _start)
ADAPTIVE = Algorithm("complementary-adaptive", ADAPTIVE_PARAMETERS, STATE, run_adaptive, _start)
