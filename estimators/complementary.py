"""Complementary filters: roll and pitch, each on its own.

    θ̂ ← γ (θ̂ + ω dt) + (1 − γ) θ_acc

The adaptive one trusts the accelerometer more while the vehicle hardly turns: for ‖ω‖ below `CALM_RATE` the
weight 1 − γ grows by k_a |θ̂ − θ_acc|.
"""

from numba import njit

from quadsim.rotation import roll_pitch_from_quat

from .filters import Algorithm, Array, Parameter
from .sample import COMMON, record, tilt_of_force_core, usable, wrap_core

CALM_RATE = 0.1
"""Body rate below which the adaptive filter leans on the accelerometer [rad/s]."""

ROLL, PITCH, SIZE = COMMON, COMMON + 1, 2


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out, target, squared_error):
    """Both filters; params: γ, and k_a for the adaptive one. See `filters` for the arguments."""
    n, steps = gyro.shape[:2]
    for row in range(states.shape[0]):
        gamma = params[row // n, 0]
        k_a = params[row // n, 1] if params.shape[1] > 1 else 0.0
        s, i = states[row], row % n
        for t in range(steps):
            gx, gy, gz, ax, ay, az = usable(s, dt, gyro, accel, i, t)
            roll, pitch = s[ROLL] + gx * dt, s[PITCH] + gy * dt
            if ax != 0.0 or ay != 0.0 or az != 0.0:
                acc_roll, acc_pitch = tilt_of_force_core(ax, ay, az)
                d_roll, d_pitch = wrap_core(acc_roll - roll), acc_pitch - pitch
                calm = k_a if gx * gx + gy * gy + gz * gz < CALM_RATE * CALM_RATE else 0.0
                roll += min(1.0 - gamma + calm * abs(d_roll), 1.0) * d_roll
                pitch += min(1.0 - gamma + calm * abs(d_pitch), 1.0) * d_pitch
            s[ROLL], s[PITCH] = wrap_core(roll), pitch
            record(row, i, t, s[ROLL], pitch, out, target, squared_error)


def _start(own: Array, quat: Array, known: bool, params: Array) -> None:
    own[:] = roll_pitch_from_quat(quat)


_GAMMA = Parameter(0.998, 0.9, 1.0 - 1e-6, "one-minus-log", maximum=1.0, per_sample="memory")


COMPLEMENTARY = Algorithm("complementary", {"gamma": _GAMMA}, sequence, SIZE, _start)
ADAPTIVE = Algorithm(
    "complementary-adaptive",
    {"gamma": _GAMMA, "k_a": Parameter(0.01, 1e-5, 1.0, per_sample="weight")},
    sequence,
    SIZE,
    _start,
)
