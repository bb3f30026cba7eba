"""Complementary filters of roll and pitch.

    θ̂ ← γ (θ̂ + ω dt) + (1 − γ) θ_acc

The adaptive filter gives the accelerometer more weight while the vehicle hardly rotates: for ‖ω‖ below
`SLOW_RATE`, the weight 1 − γ grows by k_a |θ̂ − θ_acc|.
"""

from collections.abc import Mapping

import numpy as np

from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.compiled import njit

from .driver import Array, CompiledFilter, Records
from .inline_math import tilt_of_force_core, wrap_core
from .samples import reacquire, run_vehicles

SLOW_RATE = 0.1
"""Body rate below which the adaptive filter gives the accelerometer more weight [rad/s]."""

RECORD = np.dtype([("roll", "f8"), ("pitch", "f8"), ("tilt_variance", "f8")])
"""State: angles [rad], and the variance of the tilt error caused by gaps [rad²]."""


@njit(inline="always")
def step(s, p, sample):
    """Process a sample or sequences; see `driver`."""
    gx, gy, gz = sample.gyro
    ax, ay, az = sample.accel
    roll, pitch = s.roll + gx * sample.dt, s.pitch + gy * sample.dt
    acc_roll, acc_pitch = tilt_of_force_core(ax, ay, az)
    d_roll, d_pitch = wrap_core(acc_roll - roll), acc_pitch - pitch
    more = p.k_a if gx * gx + gy * gy + gz * gz < SLOW_RATE * SLOW_RATE else 0.0
    share, s.tilt_variance = reacquire(s.tilt_variance, sample)
    weight = max(1.0 - p.gamma, share)
    if sample.found:
        roll += min(weight + more * abs(d_roll), 1.0) * d_roll
        pitch += min(weight + more * abs(d_pitch), 1.0) * d_pitch
    s.roll, s.pitch = wrap_core(roll), pitch
    return s.roll, pitch


@njit(cache=True, nogil=True, error_model="numpy")
def run(states, samples, params, dt, gyro, accel, rotor_vel, out):
    """Process a sample or sequences; see `driver`."""
    run_vehicles(step, states, samples, params, dt, gyro, accel, rotor_vel, out)


class Complementary(CompiledFilter):
    """Complementary filter of n vehicles, adaptive if it has the parameter `k_a`."""

    record, run = RECORD, staticmethod(run)

    def __init__(self, name: str, rate_hz: float, values: Mapping[str, float]) -> None:
        super().__init__(name, rate_hz, {"k_a": 0.0, **values})

    def begin(self, states: Records, quat: Array, known: bool) -> None:
        """Set the angles from the quaternion."""
        states["roll"], states["pitch"] = roll_pitch_from_quat(quat).T
