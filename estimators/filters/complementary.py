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
from .samples import LANES, by_lanes, by_rows, lanes_of, parameter_record, reacquire

SLOW_RATE = 0.1
"""Body rate below which the adaptive filter trusts the accelerometer more [rad/s]."""

STATE = np.dtype([("roll", "f8"), ("pitch", "f8"), ("tilt_variance", "f8")])
"""Angles [rad], and the variance of the tilt that gaps have left [rad²]."""

_GAMMA = Parameter(0.998, 0.9, 1.0 - 1e-6, "one-minus-log", maximum=1.0, per_sample="memory")
PARAMETERS = {"gamma": _GAMMA}
ADAPTIVE_PARAMETERS = PARAMETERS | {"k_a": Parameter(0.01, 1e-5, 1.0, per_sample="weight")}
PARAMS, ADAPTIVE_PARAMS = parameter_record(PARAMETERS), parameter_record(ADAPTIVE_PARAMETERS)
STATE_LANES, PARAM_LANES = lanes_of(STATE, LANES), lanes_of(PARAMS, LANES)
ADAPTIVE_PARAM_LANES = lanes_of(ADAPTIVE_PARAMS, LANES)


@njit(forceinline=True, error_model="numpy")
def mix(s, k, gamma, k_a, sample):
    """The equations above, for lane k of the state s."""
    gx, gy, gz = sample.gyro
    ax, ay, az = sample.accel
    roll, pitch = s.roll[k] + gx * sample.dt, s.pitch[k] + gy * sample.dt
    acc_roll, acc_pitch = tilt_of_force_core(ax, ay, az)
    d_roll, d_pitch = wrap_core(acc_roll - roll), acc_pitch - pitch
    more = k_a if gx * gx + gy * gy + gz * gz < SLOW_RATE * SLOW_RATE else 0.0
    found = 1.0 if ax != 0.0 or ay != 0.0 or az != 0.0 else 0.0
    share, s.tilt_variance[k] = reacquire(s.tilt_variance[k], sample)
    weight = max(1.0 - gamma, share)
    roll += found * min(weight + more * abs(d_roll), 1.0) * d_roll
    pitch += found * min(weight + more * abs(d_pitch), 1.0) * d_pitch
    s.roll[k], s.pitch[k] = wrap_core(roll), pitch
    return s.roll[k], pitch


@njit(forceinline=True, error_model="numpy")
def advance(s, p, k, sample):
    """See `algorithm`."""
    return mix(s, k, p.gamma[k], 0.0, sample)


@njit(forceinline=True, error_model="numpy")
def advance_adaptive(s, p, k, sample):
    """See `algorithm`."""
    return mix(s, k, p.gamma[k], p.k_a[k], sample)


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out):
    """See `algorithm`."""
    by_rows(advance, False, states, params, dt, gyro, accel, out)


@njit(cache=True, nogil=True)
def score(states, params, dt, flights):
    """See `algorithm`."""
    work = np.empty(1, STATE_LANES), np.empty(1, PARAM_LANES)
    return by_lanes(advance, False, work, states, params, dt, flights)


@njit(cache=True, nogil=True)
def sequence_adaptive(states, params, dt, gyro, accel, out):
    """See `algorithm`."""
    by_rows(advance_adaptive, False, states, params, dt, gyro, accel, out)


@njit(cache=True, nogil=True)
def score_adaptive(states, params, dt, flights):
    """See `algorithm`."""
    work = np.empty(1, STATE_LANES), np.empty(1, ADAPTIVE_PARAM_LANES)
    return by_lanes(advance_adaptive, False, work, states, params, dt, flights)


def _start(states: Records, quat: Array, known: bool, params: Records) -> None:
    states["roll"], states["pitch"] = np.split(roll_pitch_from_quat(quat), 2, axis=-1)


COMPLEMENTARY = Algorithm(
    "complementary", PARAMETERS, lanes_of(STATE), lanes_of(PARAMS), sequence, score, _start
)
ADAPTIVE = Algorithm(
    "complementary-adaptive",
    ADAPTIVE_PARAMETERS,
    lanes_of(STATE),
    lanes_of(ADAPTIVE_PARAMS),
    sequence_adaptive,
    score_adaptive,
    _start,
)
