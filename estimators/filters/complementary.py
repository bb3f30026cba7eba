"""Complementary filters: roll and pitch, each on its own.

    θ̂ ← γ (θ̂ + ω dt) + (1 − γ) θ_acc

The adaptive one trusts the accelerometer more while the vehicle hardly turns: for ‖ω‖ below `CALM_RATE` the
weight 1 − γ grows by k_a |θ̂ − θ_acc|.
"""

from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.compiled import njit

from .algorithm import Algorithm, Array, Parameter
from .inline_math import tilt_of_force_core, wrap_core
from .samples import LANES, by_lanes, by_rows, regain

CALM_RATE = 0.1
"""Body rate below which the adaptive filter leans on the accelerometer [rad/s]."""

SIZE = 3


@njit(forceinline=True, error_model="numpy")
def advance(s, p, k, dt, gx, gy, gz, ax, ay, az, unseen):
    """State: roll, pitch, doubt after a gap. Params: γ, k_a if adaptive; arguments as in `filters`."""
    gamma, k_a = p[0, k], p[1, k] if p.shape[0] > 1 else 0.0
    roll, pitch = s[0, k] + gx * dt, s[1, k] + gy * dt
    acc_roll, acc_pitch = tilt_of_force_core(ax, ay, az)
    d_roll, d_pitch = wrap_core(acc_roll - roll), acc_pitch - pitch
    calm = k_a if gx * gx + gy * gy + gz * gz < CALM_RATE * CALM_RATE else 0.0
    found = 1.0 if ax != 0.0 or ay != 0.0 or az != 0.0 else 0.0
    share, s[2, k] = regain(s[2, k], unseen, ax, ay, az, dt)
    weight = max(1.0 - gamma, share)
    roll += found * min(weight + calm * abs(d_roll), 1.0) * d_roll
    pitch += found * min(weight + calm * abs(d_pitch), 1.0) * d_pitch
    s[0, k], s[1, k] = wrap_core(roll), pitch
    return s[0, k], pitch


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out):
    """See `filters`."""
    by_rows(advance, False, states, params, dt, gyro, accel, out)


@njit(cache=True, nogil=True)
def score(states, params, dt, gyro, accel, target, squared_error):
    """See `filters`."""
    by_lanes(advance, LANES, False, states, params, dt, gyro, accel, target, squared_error)


def _start(own: Array, quat: Array, known: bool, params: Array) -> None:
    own[:, :2] = roll_pitch_from_quat(quat)


_GAMMA = Parameter(0.998, 0.9, 1.0 - 1e-6, "one-minus-log", maximum=1.0, per_sample="memory")


COMPLEMENTARY = Algorithm("complementary", {"gamma": _GAMMA}, sequence, score, SIZE, _start)
ADAPTIVE = Algorithm(
    "complementary-adaptive",
    {"gamma": _GAMMA, "k_a": Parameter(0.01, 1e-5, 1.0, per_sample="weight")},
    sequence,
    score,
    SIZE,
    _start,
)
