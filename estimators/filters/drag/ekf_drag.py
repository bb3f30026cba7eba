"""Error-state Kalman filter with known drag of the airframe, whose noise adapts to the innovations.

The filter is that of `drag_aided`, with v_z and c_z among the errors, thrust along body z, and the IMU at the
centre of mass. The noise is adapted to the innovation ν of the drag measurement:

- *Vibration*: the variance of ν is at least the low-passed variance of its white part.
- *Wind*: if the sum of corrections of the airspeed v − w exceeds the variance that they remove, the process
  noise of w increases; otherwise, it decreases (Myers & Tapley, "Adaptive sequential estimation with unknown
  noise statistics", IEEE Trans. Autom. Control 21(4), 1976).
- *Gust fronts*: a low-passed ν beyond its own variance immediately increases this process noise.
- *Bias steps*: if the sum of corrections of b far exceeds the variance that they remove, the variance of b is
  increased.
- *Velocity*: the variance of the measurement v = 0 grows with the mean square of the estimated velocity.
- *Model*: the variance of ν grows with the mean square of the horizontal acceleration, since thrust and drag
  are not known exactly.
"""

import math

import numpy as np

from quadsim.runs.compiled import njit
from quadsim.vehicle import AIR_DENSITY, GRAVITY, Vehicle

from ..driver import Array, CompiledFilter, Records
from ..ekf import SIGMA_KNOWN
from ..inline_math import roll_pitch_core, rotate
from ..samples import run_vehicles
from .drag_aided import (
    ACCEL_BIAS,
    DRAG,
    FIRST_S,
    GYRO_BIAS,
    MODEL,
    PARTS,
    REST,
    SCRATCH,
    VELOCITY,
    WIND,
    apply_error,
    at_rest,
    correct_by_drag,
    correct_by_zero_rate,
    correct_by_zero_velocity,
    diverged,
    mean_square,
    predict,
)

RECORD = np.dtype(
    [
        *MODEL,
        ("accel_W", "f8", 3),  # of the last sample, world axes [m/s²]
        ("airspeed_due", "f8"),  # variance that the corrections of v - w removed [m²/s²]
        ("bias_sum", "f8", 3),  # recent corrections of the gyroscope's bias [rad/s]
        ("bias_due", "f8"),  # variance that they removed [rad²/s²]
        ("speed_square", "f8"),  # mean square of the horizontal velocity, per axis [m²/s²]
        *REST,
        *SCRATCH,
    ]
)
"""State of the filter."""

NO_ARM = (0.0, 0.0)
"""Lever arm of an IMU at the centre of mass."""


@njit
def airspeed_variance(P):
    """Return the variance of v − w, both horizontal axes [m²/s²]."""
    total = 0.0
    for a in range(2):
        v, w = VELOCITY + a, WIND + a
        total += P[v, v] - P[v, w] - P[w, v] + P[w, w]
    return total


@njit
def bias_variance(P):
    """Return the variance of the gyroscope bias, all axes [rad²/s²]."""
    return P[GYRO_BIAS, GYRO_BIAS] + P[GYRO_BIAS + 1, GYRO_BIAS + 1] + P[GYRO_BIAS + 2, GYRO_BIAS + 2]


@njit
def adapt_wind(s, p, dt, removed):
    """Adapt the noise of the wind to a correction of the airspeed and the variance that it removed."""
    scatter = 0.0
    for k in range(2):
        moved = s.error[VELOCITY + k] - s.error[WIND + k]
        s.airspeed_sum[k] += moved - s.airspeed_sum[k] * dt / p.wind_window
        scatter += 0.5 * s.airspeed_sum[k] ** 2
    s.airspeed_due += max(0.5 * removed, 0.0) - 2.0 * s.airspeed_due * dt / p.wind_window
    excess = 2.0 * (scatter - p.wind_share * s.airspeed_due) / p.wind_window
    memory = min(0.5 * FIRST_S + s.time, p.wind_memory) if excess > 0.0 else p.wind_memory
    s.wind_noise = max(s.wind_noise + excess * dt / memory, p.wind_noise_least**2)


@njit
def adapt_bias(s, p, dt, removed):
    """Increase the variance of the gyroscope bias if its corrections show a step."""
    leak, scatter = dt / p.step_time, 0.0
    for k in range(3):
        s.bias_sum[k] += s.error[GYRO_BIAS + k] - s.bias_sum[k] * leak
        scatter += s.bias_sum[k] ** 2 / 3.0
    s.bias_due += max(removed, 0.0) / 3.0 - 2.0 * s.bias_due * leak
    inflation = max(scatter - p.step_ratio * s.bias_due, 0.0) * p.step_gain * leak
    for k in range(GYRO_BIAS, ACCEL_BIAS):
        s.covariance[k, k] += inflation


@njit
def correct_by_sample(s, p, dt, gyro, accel, matrix):
    """Apply all corrections by one sample: update error and covariance, and adapt the noise."""
    P, v = s.covariance, s.velocity
    airspeed, bias = airspeed_variance(P), bias_variance(P)
    rotor_drag = math.sqrt(max(accel[2], 0.0) / GRAVITY) / p.drag_time
    correct_by_drag(s, s, p, DRAG, accel, NO_ARM, rotor_drag, dt, matrix)
    if s.time > p.wind_window:  # the first corrections are those of the initial state
        bias -= bias_variance(P)
        adapt_wind(s, p, dt, airspeed - airspeed_variance(P))
        adapt_bias(s, p, dt, bias)
    density = max(s.speed_square, p.speed_least**2) * p.speed_time * (1.0 + p.speed_growth * s.speed_square)
    correct_by_zero_velocity(s, s, DRAG, 3, density / dt, p.climb_noise**2 / dt)
    s.speed_square = mean_square(s.speed_square, 0.5 * (v[0] ** 2 + v[1] ** 2), dt, s.time, p.speed_memory)
    if at_rest(s, p, dt, gyro, accel):
        correct_by_zero_rate(s, s, p, DRAG, gyro, dt)


@njit
def step(s, p, sample):
    """Process a sample or sequences; see `driver`."""
    v, c, dt, gyro, accel = s.velocity, s.accel_bias, sample.dt, sample.mean_gyro, sample.accel
    s.time += dt
    turn = (gyro[0] * dt, gyro[1] * dt, gyro[2] * dt)
    matrix = predict(s, s, p, DRAG, turn, dt, 0.0, sample.unseen, 1.0 / p.drag_time, True)
    s.error[:] = 0.0
    if sample.found:
        fx, fy, fz = rotate(s.quat, (accel[0] - c[0], accel[1] - c[1], accel[2] - c[2]))
        now = (fx, fy, fz - GRAVITY)
        for k in range(3):  # trapezoidal rule
            v[k] += 0.5 * (now[k] + (s.accel_W[k] if s.time > dt else now[k])) * dt
            s.accel_W[k] = now[k]
        s.accel_square = mean_square(s.accel_square, 0.5 * (fx * fx + fy * fy), dt, s.time, p.accel_memory)
        correct_by_sample(s, p, dt, gyro, accel, matrix)
    apply_error(s, s.error)
    if diverged(s.gyro_bias, s.velocity) or diverged(s.gyro_bias, s.wind):
        return math.nan, math.nan
    return roll_pitch_core(s.quat)


@njit(cache=True, nogil=True)
def run(states, samples, params, dt, gyro, accel, rotor_vel, out):
    """Process a sample or sequences; see `driver`."""
    run_vehicles(step, states, samples, params, dt, gyro, accel, rotor_vel, out)


class EkfDrag(CompiledFilter):
    """The filter for n vehicles."""

    record, run = RECORD, staticmethod(run)

    def begin(self, states: Records, quat: Array, known: bool) -> None:
        """Start at a known attitude, or at level with an unknown tilt."""
        p, tilt, others = self.values, PARTS[:VELOCITY], PARTS[VELOCITY:DRAG]
        sigma = [SIGMA_KNOWN if known else p[f"{part}_sigma"] for part in tilt]
        sigma += [p[f"{part}_sigma"] for part in others]
        states["quat"] = quat
        states["covariance"][:, range(DRAG), range(DRAG)] = np.square(sigma)
        states["wind_noise"], states["speed_square"] = p["wind_noise"] ** 2, p["speed_sigma"] ** 2


def drag_of(vehicle: Vehicle) -> dict[str, float]:
    """Return `drag_time` and `frame_drag` of a vehicle."""
    area = 0.5 * (vehicle.frame.drag_area[0] + vehicle.frame.drag_area[1])
    return {
        "drag_time": vehicle.drag_time_constant,
        "frame_drag": 0.5 * AIR_DENSITY * area / vehicle.mass,
    }
