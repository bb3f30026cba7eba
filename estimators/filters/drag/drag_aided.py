"""The drag-aided error-state filter, used alone in `ekf_drag` and with other models in `imm`.

Without drag, the accelerometer of a flying quadrotor reads only thrust along body z, at any tilt. The other
components are rotor and frame drag and measure airspeed, not tilt (Martin & Salaün, "The true role of
accelerometer feedback in quadrotor control", ICRA 2010; Leishman et al., "Quadrotors and accelerometers",
IEEE Control Systems 34(1), 2014). The tilt follows from the changes of the airspeed.

The state consists of attitude R, velocity v and horizontal wind w (world axes), gyroscope bias b,
accelerometer bias c, direction of thrust o as a tilt from body z, and height l of the IMU above the centre of
mass:

    Ṙ = R [ω − b]×,    v̇ = R (a − c) + g,    ẇ, ḃ, ċ, ȯ, l̇ random walks,
    a_xy = −D (Rᵀ (v − w))_xy + c_xy + g o + l (α_y, −α_x) + noise,    D = k √(a_z / g) + f |v − w|

Rotor drag is proportional to the sum of rotor speeds, hence to the root of thrust; k is its coefficient at
hover, f the quadratic drag of the frame per mass, and α the angular acceleration. A second, weak measurement
is v = 0: on average, the vehicle does not move. At rest, a third measurement is that the gyroscope reads its
bias (a zero-rate update, as in VQF: Laidig & Seel, Information Fusion 91, 2023).

The error is right-invariant as in `eskf`: θ is in world axes, and v = exp([θ]×) v̂ + δv, similarly for w. The
drag measurement then does not depend on θ or on the heading; its matrix is −D R̂ᵀ for δv − δw.

The functions have these arguments: m is the record of a model, with the fields of `MODEL`; scratch has the
fields of `SCRATCH` and may be the same record; p contains the parameters of the filter; size is the number of
errors in the state; matrix is R̂ by rows; dt is the time step [s].
"""

import math

import numpy as np

from quadsim.rotation import from_rotvec_core, matrix_core
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from ...sanitise import within
from ..ekf import correct
from ..eskf import turned
from ..inline_math import exp_core, multiply, put, rotate

TILT, VELOCITY, GYRO_BIAS, ACCEL_BIAS, WIND = 0, 2, 4, 7, 9
CLIMB, ACCEL_BIAS_Z, OFFSET, LEVER = 11, 12, 13, 15
"""Offsets of the parts of the error state: horizontal axes, three axes of the gyroscope bias, and then v_z,
c_z, o and l, which not every filter estimates."""
SHARED, DRAG, ERRORS = 9, 13, 16
"""Number of errors of a model without drag; with drag, v_z and all of c; and with all parts."""
PARTS = np.repeat(
    ["attitude", "speed", "bias", "accel_bias", "wind", "speed", "accel_bias", "offset", "lever"],
    [2, 2, 3, 2, 2, 1, 1, 2, 1],
)
"""Parameter with the initial standard deviation of each error, without the suffix `_sigma`."""

MODEL = [
    ("quat", "f8", 4),
    ("velocity", "f8", 3),
    ("wind", "f8", 2),
    ("gyro_bias", "f8", 3),
    ("accel_bias", "f8", 3),
    ("offset", "f8", 2),  # of the direction of thrust from body z [rad]
    ("lever", "f8"),  # height of the IMU over the centre of mass [m]
    ("covariance", "f8", (ERRORS, ERRORS)),
    ("time", "f8"),  # since the start [s]
    ("accel_square", "f8"),  # mean square of the horizontal acceleration [m²/s⁴]
    ("innovation", "f8", 2),  # of the drag measurement at the last update, world axes [m/s²]
    ("innovation_mean", "f8", 2),  # low-passed [m/s²]
    ("vibration", "f8"),  # variance of the white part of it [m²/s⁴]
    ("wind_noise", "f8"),  # process noise of the wind [m²/s³]
    ("airspeed_sum", "f8", 2),  # recent corrections of v - w [m/s]
]
"""Fields of the state of one model."""
REST = [
    ("rest_time", "f8"),  # for which the readings have not changed [s]
    ("fast", "f8", 6),  # low-passed readings
    ("slow", "f8", 6),
]
"""Fields of `at_rest`."""
SCRATCH = [
    ("moved", "f8", (ERRORS, ERRORS)),  # F P Fᵀ
    ("error", "f8", ERRORS),  # estimated so far
    ("column", "f8", ERRORS),  # P hᵀ of a measurement
    ("walks", "f8", ERRORS),  # variances that a sample adds
]
"""Temporary fields for a sample. They are part of the record, because fields of one record never overlap."""

BIAS_MAX, SPEED_MAX = math.radians(30.0), 60.0
"""Bias of the gyroscope [rad/s], velocity and wind [m/s] beyond which a filter has diverged and restarts."""
FIRST_S = 0.1
"""Weight of the first value of a mean square, as a duration [s]."""


@njit
def transition(P, matrix, v, w, dt, climbs):
    """Compute P ← F P, with θ̇ = −R̂ δb, δv̇ = −θ × g − R̂ δc − v̂ × R̂ δb and δẇ = −ŵ × R̂ δb.

    With `climbs`, v_z and c_z are among the errors.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = matrix
    vx, vy, vz, wx, wy = v[0], v[1], v[2], w[0], w[1]
    for j in range(ERRORS):
        x, y = P[TILT, j], P[TILT + 1, j]
        b0, b1, b2 = P[GYRO_BIAS, j], P[GYRO_BIAS + 1, j], P[GYRO_BIAS + 2, j]
        c0, c1 = P[ACCEL_BIAS, j], P[ACCEL_BIAS + 1, j]
        bx = r00 * b0 + r01 * b1 + r02 * b2  # R̂ δb
        by = r10 * b0 + r11 * b1 + r12 * b2
        bz = r20 * b0 + r21 * b1 + r22 * b2
        P[TILT, j] = x - dt * bx
        P[TILT + 1, j] = y - dt * by
        P[VELOCITY, j] += dt * (GRAVITY * y - r00 * c0 - r01 * c1 - (vy * bz - vz * by))
        P[VELOCITY + 1, j] += dt * (-GRAVITY * x - r10 * c0 - r11 * c1 - (vz * bx - vx * bz))
        P[WIND, j] -= dt * wy * bz
        P[WIND + 1, j] += dt * wx * bz
        if climbs:
            c2 = P[ACCEL_BIAS_Z, j]
            P[VELOCITY, j] -= dt * r02 * c2
            P[VELOCITY + 1, j] -= dt * r12 * c2
            P[CLIMB, j] -= dt * (r20 * c0 + r21 * c1 + r22 * c2 + (vx * by - vy * bx))


@njit
def propagate(m, scratch, size, matrix, dt, climbs):
    """Compute P ← F P Fᵀ + Q = F (F P)ᵀ + Q for a symmetric P; `scratch.walks` is the diagonal of Q."""
    P, T, v, w = m.covariance, scratch.moved, m.velocity, m.wind
    transition(P, matrix, v, w, dt, climbs)
    for i in range(ERRORS):
        for j in range(ERRORS):
            T[i, j] = P[j, i]
    transition(T, matrix, v, w, dt, climbs)
    for i in range(size):
        for j in range(ERRORS):
            P[i, j] = T[i, j]
        P[i, i] += scratch.walks[i]


@njit
def predict(m, scratch, p, size, turn, dt, scale_error, unseen, drag, climbs):
    """Rotate a model and propagate its covariance, except for the random walks of o and l; return R̂.

    `turn` is the measured rotation vector [rad], `scale_error` its variance by errors proportional to the
    rate, `unseen` the variance of unmeasured rotation [rad²], and `drag` is D at hover [1/s].
    """
    walks, b = scratch.walks, m.gyro_bias
    walks[TILT:VELOCITY] = p.gyro_noise**2 * dt + scale_error + unseen
    walks[VELOCITY:GYRO_BIAS] = p.accel_noise**2 * dt + p.gap_speed**2 * unseen
    walks[GYRO_BIAS:ACCEL_BIAS] = p.bias_noise**2 * dt
    walks[ACCEL_BIAS:WIND] = p.accel_bias_noise**2 * dt
    walks[WIND:CLIMB] = max(m.wind_noise, gust_noise(m, p, dt, drag)) * dt
    walks[CLIMB] = walks[VELOCITY] if climbs else 0.0
    walks[ACCEL_BIAS_Z] = walks[ACCEL_BIAS] if climbs else 0.0
    step = from_rotvec_core(turn[0] - b[0] * dt, turn[1] - b[1] * dt, turn[2] - b[2] * dt)
    put(m.quat, multiply(m.quat, step))
    matrix = matrix_core(m.quat[0], m.quat[1], m.quat[2], m.quat[3])
    propagate(m, scratch, size, matrix, dt, climbs)
    return matrix


@njit
def least_variance(m, p, dt):
    """Return the variance of the drag measurement by noise or, if larger, by vibration [m²/s⁴]."""
    return max(m.vibration, p.drag_noise**2 / dt)


@njit
def along_drag(x, y, z, arm, k, error, noise):
    """Return the drag measurement of axis k for an error and noise, given row k of −D R̂ᵀ."""
    across = x * (error[VELOCITY] - error[WIND]) + y * (error[VELOCITY + 1] - error[WIND + 1])
    own = error[ACCEL_BIAS + k] + GRAVITY * error[OFFSET + k] + arm * error[LEVER]
    return across + (own + z * error[CLIMB] + noise)


@njit
def correct_by_drag(m, scratch, p, size, force, arm, rotor_drag, dt, matrix):
    """Correct by the specific force perpendicular to thrust, one axis after the other; adapt its variance.

    `force` is the specific force in body axes (3,) [m/s²], `arm` the addition to it per metre of lever arm
    (2,) [1/s²], and `rotor_drag` the part of D by the rotors [1/s].
    """
    P, v, w, dx, column = m.covariance, m.velocity, m.wind, scratch.error, scratch.column
    airspeed = math.sqrt((v[0] - w[0]) ** 2 + (v[1] - w[1]) ** 2 + v[2] ** 2)
    drag = rotor_drag + p.frame_drag * airspeed
    variance = least_variance(m, p, dt) + p.model_noise**2 * 2.0 * m.accel_square / dt
    first = innovation = 0.0
    for k in range(2):
        x, y, z = -drag * matrix[k], -drag * matrix[3 + k], -drag * matrix[6 + k]
        expected = x * (v[0] - w[0]) + y * (v[1] - w[1]) + z * v[2] + m.accel_bias[k] + GRAVITY * m.offset[k]
        expected += arm[k] * m.lever
        innovation = min(max(force[k] - expected, -p.innovation_max), p.innovation_max)
        first = innovation if k == 0 else first
        for a in range(ERRORS):
            column[a] = along_drag(x, y, z, arm[k], k, P[:, a], 0.0)
        total = along_drag(x, y, z, arm[k], k, column, variance)
        correct(P, size, dx, column, total, innovation - along_drag(x, y, z, arm[k], k, dx, 0.0))
    adapt_vibration(m, p, dt, rotate(m.quat, (first, innovation, 0.0)))


@njit
def correct_by_zero_velocity(m, scratch, size, axes, variance, climb_variance):
    """Correct by the measurement v = 0, for the first two or all three axes in turn."""
    P, v, dx, column = m.covariance, m.velocity, scratch.error, scratch.column
    for k in range(axes):
        x, y = (0.0, -v[2], v[1])[k], (v[2], 0.0, -v[0])[k]  # of θ × v̂
        own = CLIMB if k == 2 else VELOCITY + k
        for a in range(ERRORS):
            column[a] = x * P[TILT, a] + y * P[TILT + 1, a] + P[own, a]
        total = x * column[TILT] + y * column[TILT + 1] + column[own]
        total += climb_variance if k == 2 else variance
        known = x * dx[TILT] + y * dx[TILT + 1] + dx[own]
        correct(P, size, dx, column, total, -v[k] - known)


@njit
def correct_by_zero_rate(m, scratch, p, size, rate, dt):
    """Correct by the gyroscope at rest, which reads its bias."""
    P, dx, column = m.covariance, scratch.error, scratch.column
    for k in range(3):
        column[:] = P[GYRO_BIAS + k]
        residual = rate[k] - m.gyro_bias[k] - dx[GYRO_BIAS + k]
        correct(P, size, dx, column, column[GYRO_BIAS + k] + p.rest_noise**2 / dt, residual)


@njit
def apply_error(m, dx):
    """Correct the state of a model by the estimated error."""
    put(m.quat, turned(m.quat, dx[TILT], dx[TILT + 1]))
    turn = exp_core(dx[TILT], dx[TILT + 1], 0.0)
    v, w = rotate(turn, m.velocity), rotate(turn, (m.wind[0], m.wind[1], 0.0))
    put(m.velocity, (v[0] + dx[VELOCITY], v[1] + dx[VELOCITY + 1], v[2] + dx[CLIMB]))
    put(m.wind, (w[0] + dx[WIND], w[1] + dx[WIND + 1]))
    for i in range(3):
        m.gyro_bias[i] += dx[GYRO_BIAS + i]
    for i in range(2):
        m.accel_bias[i] += dx[ACCEL_BIAS + i]
        m.offset[i] += dx[OFFSET + i]
    m.accel_bias[2] += dx[ACCEL_BIAS_Z]
    m.lever += dx[LEVER]


@njit
def mean_square(value, square, dt, time, memory):
    """Update a mean square by another square value."""
    return value + (square - value) * dt / min(FIRST_S + time, memory)


@njit
def adapt_vibration(m, p, dt, now):
    """Update the mean of the innovation ν in world axes, and its white variance by ¼ |ν[t] − ν[t−1]|²."""
    change = (now[0] - m.innovation[0]) ** 2 + (now[1] - m.innovation[1]) ** 2
    if m.time > dt:
        m.vibration += (0.25 * change - m.vibration) * dt / p.vibration_memory
    for k in range(2):
        m.innovation[k] = now[k]
        m.innovation_mean[k] += (now[k] - m.innovation_mean[k]) * dt / p.gust_window


@njit
def gust_noise(m, p, dt, drag):
    """Return the process noise of the wind for a low-passed innovation beyond its variance [m²/s³]."""
    square = m.innovation_mean[0] ** 2 + m.innovation_mean[1] ** 2
    usual = p.gust_ratio * least_variance(m, p, dt) * dt / p.gust_window
    return max(square - usual, 0.0) / p.gust_window / (drag * drag)


@njit
def at_rest(s, p, dt, gyro, accel):
    """Low-pass the readings; return whether they have been constant for long enough."""
    same = True
    fast, slow = dt / min(s.time, p.rest_fast), dt / min(s.time, p.rest_delay)
    for k in range(6):
        value, most = (gyro[k], p.rest_rate) if k < 3 else (accel[k - 3], p.rest_accel)
        s.fast[k] += min(fast, 1.0) * (value - s.fast[k])
        s.slow[k] += min(slow, 1.0) * (value - s.slow[k])
        same &= abs(s.fast[k] - s.slow[k]) <= most and (k >= 3 or abs(s.slow[k]) <= p.rest_rate_most)
    s.rest_time = s.rest_time + dt if same else 0.0
    return s.rest_time >= p.rest_delay


@njit
def diverged(gyro_bias, velocity):
    """Return whether an estimate is NaN or beyond plausible limits."""
    bx, by, bz = gyro_bias
    possible = within(bx, by, bz, BIAS_MAX)
    for value in velocity:
        possible &= abs(value) <= SPEED_MAX
    return not possible
