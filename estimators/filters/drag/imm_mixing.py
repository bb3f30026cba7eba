"""How `imm` combines its models, and mixes each with the combination."""

import math

from quadsim.runs.compiled import njit

from ..eskf import turned
from ..inline_math import atan2_core, multiply, put, rotate
from .drag_aided import (
    ACCEL_BIAS,
    ERRORS,
    GYRO_BIAS,
    LEVER,
    OFFSET,
    SHARED,
    SPEED_MAX,
    TILT,
    VELOCITY,
    WIND,
)
from .imm_model import COUNT, MULTIROTOR


@njit
def share_heading(s):
    """Turn all models about the vertical to the likeliest one's heading; their tilts from it."""
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
    """Error of a combined state against a model's, d (ERRORS,); `tilt` is from the combined attitude."""
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
    """Mean and covariance over all models of what they share."""
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
    """Move each model towards the combination by the share of its probability that comes from others."""
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
    """Mix what multirotors alone have with the initial state, by that share."""
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
