"""The models of `imm`, each a filter of attitude, motion and sensor errors for one kind of carrier.

The multirotor is the model of `drag_aided`. The others have no wind, direction of thrust, lever arm or drag
measurement. The vertical velocity v_z is not an error here: it is integrated with a memory of `climb_time`.

The bias of a gyroscope may step. The sum of the expected corrections of θ has a variance equal to the
reduction of the variance of θ. Let r be the ratio of the square of this sum, within T = `step_time`, to this
variance. The ratio should be 1, but depends on the motion: 0.1 in calm flight, 1 in repeated dashes. A step
is detected if r exceeds `step_ratio` times its own mean over `step_memory`, a threshold with constant
false-alarm rate (after Willsky & Jones, "A generalized likelihood ratio approach to the detection and
estimation of jumps in linear systems", IEEE Trans. Autom. Control 21(1), 1976). The covariance is then
increased to that of an unknown step:

    P ← P + `step_sigma`² G Gᵀ,    G = (−T R, ½ T² g × R, I) of θ, v and b
"""

import math
from typing import NamedTuple

import numpy as np

from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from ..eskf import turned
from ..inline_math import atan2_core, multiply, put, rotate
from .drag_aided import (
    ACCEL_BIAS,
    ERRORS,
    GYRO_BIAS,
    LEVER,
    MODEL,
    OFFSET,
    SHARED,
    SPEED_MAX,
    TILT,
    VELOCITY,
    WIND,
    apply_error,
    correct_by_drag,
    correct_by_zero_rate,
    correct_by_zero_velocity,
    mean_square,
    predict,
)

MODELS = ("multirotor", "free", "hand")
MULTIROTOR, FREE, HAND = range(len(MODELS))
COUNT = len(MODELS)

STATE = np.dtype(
    [
        *MODEL,
        ("tilt", "f8", 2),  # from the combined attitude, world axes [rad]
        ("airspeed_square", "f8"),  # sum of squares of the corrections of v - w, both axes [m²/s²]
        ("tilt_sum", "f8", 2),  # recent corrections of the tilt, world axes [rad]
        ("tilt_due", "f8"),  # variance that they removed, both axes [rad²]
        ("usual_ratio", "f8"),  # mean of the ratio of both
        ("step_clock", "f8"),  # since the start or the last step of the bias [s]
    ]
)
"""State of one model."""

WIND_NOISE_MOST = 10.0
"""Largest noise density of the wind, that of gusts in a hurricane [m/s/√s]."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t."""


class Integrated(NamedTuple):
    """Integrated readings since the last update of the models, in compiled code."""

    dt: float
    """Length of the interval [s]."""
    turn: tuple[float, float, float]
    """Measured rotation vector [rad]."""
    rate: tuple[float, float, float]
    """Mean body rate [rad/s]."""
    unseen: float
    """Variance of the unmeasured rotation [rad²]."""
    found: bool
    """Whether there is a specific force."""
    accel: tuple[float, float, float]
    """Mean specific force, in body axes at the end of the interval [m/s²]."""
    body: tuple[float, float, float]
    """Mean specific force, in rotating body axes [m/s²]."""
    thrust: float
    """Thrust per mass [m/s²]."""
    arm: tuple[float, float]
    """Addition to the specific force per metre of lever arm [1/s²]."""
    resting: bool
    """Whether the sensors are at rest."""


@njit
def size_of(k):
    """Return the number of errors in model k."""
    return ERRORS if k == MULTIROTOR else SHARED


@njit
def adapt_wind(m, p, dt, moved):
    """Increase the noise of the wind while corrections of the airspeed (2,) are correlated.

    Decrease it otherwise.

    If the corrections are white, the square of their sum over a short memory equals the sum of their squares.
    It is larger if the wind changes faster than its noise allows.
    """
    leak = min(dt / p.wind_window, 0.5)
    square = 0.0
    for k in range(2):
        m.airspeed_sum[k] += moved[k] - leak * m.airspeed_sum[k]
        square += m.airspeed_sum[k] ** 2
    m.airspeed_square += moved[0] ** 2 + moved[1] ** 2 - leak * (2.0 - leak) * m.airspeed_square
    if m.airspeed_square > 0.0:
        growth = (square / m.airspeed_square / p.wind_share - 1.0) * dt / p.wind_memory
        noise = m.wind_noise * math.exp(min(growth, 1.0))
        m.wind_noise = min(max(noise, p.wind_noise_least**2), WIND_NOISE_MOST**2)


@njit
def student(square, determinant):
    """Return the log-density of Student's t for two variables, up to a constant; see `correct_by_drag`."""
    return -0.5 * (FREEDOM + 2.0) * math.log(1.0 + square / FREEDOM) - 0.5 * math.log(determinant)


@njit
def velocity_density(m, sigma):
    """Return the log-density of the horizontal velocity, with standard deviation sigma [m/s]."""
    P, vx, vy = m.covariance, m.velocity[0], m.velocity[1]
    xx, yy = sigma * sigma + P[VELOCITY, VELOCITY], sigma * sigma + P[VELOCITY + 1, VELOCITY + 1]
    xy = P[VELOCITY, VELOCITY + 1]
    determinant = xx * yy - xy * xy
    return student((yy * vx * vx - 2.0 * xy * vx * vy + xx * vy * vy) / determinant, determinant)


@njit
def across_thrust(m, x):
    """Return the force perpendicular to thrust, without accelerometer bias and lever-arm effect [m/s²]."""
    first = x.body[0] - m.accel_bias[0] - GRAVITY * m.offset[0] - x.arm[0] * m.lever
    return first, x.body[1] - m.accel_bias[1] - GRAVITY * m.offset[1] - x.arm[1] * m.lever


@njit
def force_density(x, y, mean_square, least):
    """Return the log-density of a force perpendicular to an axis, for a mean square per component [m/s²]."""
    variance = mean_square + least * least
    return student((x * x + y * y) / variance, variance * variance)


@njit
def predict_model(m, k, s, p, x):
    """Propagate model k of the filter s over an interval; return R̂ by rows."""
    v, c, dt, turn = m.velocity, m.accel_bias, x.dt, x.turn
    m.time = s.time
    rate_square = (turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2) / dt
    s.walks[OFFSET:LEVER] = p.offset_noise**2 * dt
    s.walks[LEVER] = p.lever_noise**2 * dt
    scale_error = p.turn_noise**2 * rate_square
    matrix = predict(m, s, p, size_of(k), turn, dt, scale_error, x.unseen, p.drag, False)
    if x.found:
        fx, fy, fz = rotate(m.quat, (x.accel[0] - c[0], x.accel[1] - c[1], x.accel[2]))
        v[0], v[1] = v[0] + fx * dt, v[1] + fy * dt
        v[2] += (fz - GRAVITY - v[2] / p.climb_time) * dt
        square = 0.5 * (fx * fx + fy * fy)
        m.accel_square = mean_square(m.accel_square, square, dt, s.time, p.square_memory)
    return matrix


@njit
def correct_model(m, k, s, p, x, matrix):
    """Correct model k of the filter s by the measurements of an interval; return their log-likelihood."""
    P, accel, dt, size, dx = m.covariance, x.accel, x.dt, size_of(k), s.error
    dx[:] = 0.0
    speed = p.hand_speed if k == HAND else p.flight_speed
    density = velocity_density(m, speed) * dt / p.speed_time
    before = P[TILT, TILT] + P[TILT + 1, TILT + 1]
    if k == MULTIROTOR:
        rotor_drag = p.drag * math.sqrt(max(x.thrust, 0.0) / GRAVITY)
        correct_by_drag(m, s, p, size, x.body, x.arm, rotor_drag, dt, matrix)
        if m.time > p.wind_window:  # the first corrections are those of the initial state
            adapt_wind(m, p, dt, (dx[VELOCITY] - dx[WIND], dx[VELOCITY + 1] - dx[WIND + 1]))
        first, second = across_thrust(m, x)
        square = s.body_square
    else:
        first = matrix[0] * accel[0] + matrix[1] * accel[1] + matrix[2] * accel[2]
        second = matrix[3] * accel[0] + matrix[4] * accel[1] + matrix[5] * accel[2]
        square = m.accel_square
    density += min(dt / p.evidence_time, 1.0) * force_density(first, second, square, p.least_accel)
    speed = p.rest_speed if x.resting else speed
    correct_by_zero_velocity(m, s, size, 2, speed * speed * p.speed_time / dt, 0.0)
    if x.resting:
        correct_by_zero_rate(m, s, p, size, x.rate, dt)
    adapt_bias(m, p, dt, dx, before - P[TILT, TILT] - P[TILT + 1, TILT + 1], matrix)
    apply_error(m, dx)
    return density


@njit
def adapt_bias(m, p, dt, dx, removed, matrix):
    """Monitor corrections of the tilt and the variance that they removed.

    Increase the covariance if the bias steps.
    """
    leak, scatter, P = dt / p.step_time, 0.0, m.covariance
    for k in range(2):
        m.tilt_sum[k] += dx[TILT + k] - leak * m.tilt_sum[k]
        scatter += m.tilt_sum[k] ** 2
    m.tilt_due += max(removed, 0.0) - 2.0 * leak * m.tilt_due
    m.step_clock += dt
    if m.step_clock <= p.step_time or m.tilt_due <= 0.0:
        return
    ratio, usual = scatter / m.tilt_due, m.usual_ratio
    m.usual_ratio += (
        (min(ratio, p.usual_most * usual) - usual) * dt / min(p.usual_delay + m.time, p.step_memory)
    )
    if ratio > p.step_ratio * max(m.usual_ratio, p.usual_least):
        m.tilt_sum[:], m.tilt_due, m.step_clock = 0.0, 0.0, 0.0
        fallen = 0.5 * GRAVITY * p.step_time
        for k in range(3):
            x, y = -p.step_time * matrix[k], -p.step_time * matrix[3 + k]
            wrong = (x, y, fallen * y, -fallen * x, 1.0 * (k == 0), 1.0 * (k == 1), 1.0 * (k == 2))  # G[:, k]
            for i in range(ACCEL_BIAS):
                for j in range(ACCEL_BIAS):
                    P[i, j] += p.step_sigma**2 * wrong[i] * wrong[j]


@njit
def share_heading(s):
    """Rotate all models about the vertical to the heading of the most probable one.

    Return their tilts from it.
    """
    best = 0
    for k in range(COUNT):
        best = k if s.probability[k] > s.probability[best] else best
    bw, bx, by, bz = s.models[best].quat
    for k in range(COUNT):
        m = s.models[k]
        w, x, y, z = multiply(m.quat, (bw, -bx, -by, -bz))
        length = math.sqrt(w * w + z * z)
        cosine, sine = (w / length, z / length) if length > 0.0 else (1.0, 0.0)  # of half the heading
        back = (cosine, 0.0, 0.0, -sine)
        put(m.quat, multiply(back, m.quat))
        m.velocity[0], m.velocity[1], _ = rotate(back, (m.velocity[0], m.velocity[1], 0.0))
        m.wind[0], m.wind[1], _ = rotate(back, (m.wind[0], m.wind[1], 0.0))
        x, y = cosine * x + sine * y, cosine * y - sine * x
        across = math.sqrt(x * x + y * y)
        scale = 2.0 if across < 1e-9 else 2.0 * atan2_core(across, length) / across
        m.tilt[0], m.tilt[1] = scale * x, scale * y
    return best


@njit
def distance(m, s, d):
    """Compute the error d (ERRORS,) of a combined state relative to a model.

    `tilt` is from the combined attitude.
    """
    x, y, v = m.tilt[0], m.tilt[1], s.velocity
    d[TILT], d[TILT + 1] = x, y
    d[VELOCITY] = m.velocity[0] - v[0] - y * v[2]
    d[VELOCITY + 1] = m.velocity[1] - v[1] + x * v[2]
    for k in range(3):
        d[GYRO_BIAS + k] = m.gyro_bias[k] - s.gyro_bias[k]
    for k in range(2):
        d[ACCEL_BIAS + k] = m.accel_bias[k] - s.accel_bias[k]


@njit
def combine(s):
    """Compute mean and covariance of the common state over all models."""
    best, d = share_heading(s), s.error
    x = y = s.accel_square = 0.0
    s.velocity[:], s.gyro_bias[:], s.accel_bias[:], s.covariance[:] = 0.0, 0.0, 0.0, 0.0
    for k in range(COUNT):
        m, share = s.models[k], s.probability[k]
        x, y = x + share * m.tilt[0], y + share * m.tilt[1]
        s.accel_square += share * m.accel_square
        for i in range(3):
            s.velocity[i] += share * m.velocity[i]
            s.gyro_bias[i] += share * m.gyro_bias[i]
            s.accel_bias[i] += share * m.accel_bias[i]
    put(s.quat, turned(s.models[best].quat, x, y))
    for k in range(COUNT):
        m, share = s.models[k], s.probability[k]
        m.tilt[0], m.tilt[1] = m.tilt[0] - x, m.tilt[1] - y
        distance(m, s, d)
        for i in range(SHARED):
            for j in range(SHARED):
                s.covariance[i, j] += share * (m.covariance[i, j] + d[i] * d[j])


@njit
def mix(s, p, change):
    """Move each model towards the combination by the share of probability from other models."""
    d = s.error
    for k in range(COUNT):
        m = s.models[k]
        share = change * (1.0 - s.probability[k])
        share /= share + s.probability[k]
        distance(m, s, d)
        own, both = 1.0 - share, share * (1.0 - share)
        for i in range(SHARED):
            for j in range(SHARED):
                mixed = own * m.covariance[i, j] + share * s.covariance[i, j]
                m.covariance[i, j] = mixed + both * d[i] * d[j]
        if k == MULTIROTOR:
            beyond = max(abs(m.wind[0]), abs(m.wind[1])) > SPEED_MAX
            forget_airframe(m, p, 1.0 if beyond else share)
        put(m.quat, turned(m.quat, -share * m.tilt[0], -share * m.tilt[1]))
        m.accel_square += share * (s.accel_square - m.accel_square)
        for i in range(3):
            m.velocity[i] += share * (s.velocity[i] - m.velocity[i])
            m.gyro_bias[i] += share * (s.gyro_bias[i] - m.gyro_bias[i])
            m.accel_bias[i] += share * (s.accel_bias[i] - m.accel_bias[i])


@njit
def forget_airframe(m, p, share):
    """Mix the states that only multirotors have with their initial values, by this share."""
    own, P = 1.0 - share, m.covariance
    for i in range(SHARED, ERRORS):
        for j in range(ERRORS):
            P[i, j] *= own
            P[j, i] = P[i, j]
    for k in range(2):
        P[WIND + k, WIND + k] += share * (p.wind_sigma**2 + own * m.wind[k] ** 2)
        P[OFFSET + k, OFFSET + k] += share * (p.offset_sigma**2 + own * m.offset[k] ** 2)
        m.wind[k] *= own
        m.offset[k] *= own
    P[LEVER, LEVER] += share * (p.lever_sigma**2 + own * m.lever**2)
    m.lever *= own
