"""Interacting multiple models: one filter for an airframe that nobody has described.

Blom & Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Trans. Autom. Control 33(8), 1988. Three hypotheses of what carries the IMU, each a Kalman
filter (`imm_model`) with probability μ:

    multirotor    the force across thrust is drag; v = 0 within metres a second
    free          anything that moves within metres a second
    hand          anything slower, within a metre a second

The likelihood Λ of a model is the product of

- the density of a force that should be small: for a multirotor the force across thrust, for the others the
  horizontal force in the world, by the model's attitude. Each has its own mean square over some seconds as
  its variance, so that the smaller of both wins. Such forces are not white: their logarithm counts once per
  `evidence_time`;
- the density of the velocity, once per `speed_time`.

All densities are of Student's t. The model changes at random, with the same rate to every other one, on
average once per `sojourn_time`:

    ε_j = dt / (3 sojourn_time) (1 − μ_j),    μ_j ← (μ_j + ε_j) Λ_j / Σ

Mixing then moves model j towards the combination of all by the share ε_j / (μ_j + ε_j): none for a model that
is believed, and the whole way for one that is not, which therefore is ready to take over. What multirotors
alone have, wind, direction of thrust and lever arm, mixes with its initial state by that share.

All models are told when the sensors are at rest, as `ekf_drag` is: the velocity is then zero, and the
gyroscope reads its bias.

Heading cannot be observed: all models are turned about the vertical to the heading of the likeliest. Readings
are integrated at their own rate to a turn and a change of velocity (Savage, "Strapdown inertial navigation
integration algorithm design", J. Guidance 21, 1998), which the models take at `MODEL_HZ`; in between, the
combined attitude turns with the gyroscope.

Rotor speeds ω are optional, in every sample. Where they are given, thrust in the drag is κ Σ ω² in place of
the force along body z, which vibration disturbs; κ, which no one has to know, is the least-squares ratio of
that force to Σ ω² over `square_memory`. Where one is missing, or the rotors stand still, it is that force.
"""

import math

import numpy as np

from quadsim.rotation import multiply_core, rotate_core
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from ..sanitise import within
from .algorithm import Algorithm, Array, Filter, Parameter, Records, score_of, sequence_of, tilt_block
from .ekf_drag import SPEED_MAX, at_rest, diverged, mean_square
from .eskf import tilt_core, turned
from .imm_model import (
    ACCEL_BIAS,
    COUNT,
    ERRORS,
    GYRO_BIAS,
    LEVER,
    MODEL,
    MODELS,
    MULTIROTOR,
    OFFSET,
    SHARED,
    TILT,
    VELOCITY,
    WIND,
    across_thrust,
    correct_model,
    predict,
)
from .inline_math import atan2_core, exp_core, roll_pitch_core
from .samples import parameter_record

STATE = np.dtype(
    [
        ("models", MODEL, (COUNT,)),
        ("probability", "f8", COUNT),
        ("quat", "f8", 4),  # combined
        ("velocity", "f8", 3),
        ("gyro_bias", "f8", 3),
        ("accel_bias", "f8", 2),
        ("covariance", "f8", (SHARED, SHARED)),
        ("accel_square", "f8"),  # as of the models
        ("body_square", "f8"),  # mean square of the force across body z, per axis [m²/s⁴]
        ("rest_time", "f8"),  # for which the readings have not changed [s]
        ("fast", "f8", 6),  # low-passed readings
        ("slow", "f8", 6),
        ("begun", "f8"),  # whether the attitude is known or has been taken from the first force
        ("time", "f8"),  # since the start [s]
        ("interval", "f8"),  # since the last update of the models [s]
        ("force_time", "f8"),  # part of it with a specific force [s]
        ("turn", "f8", 4),  # in that interval, a quaternion
        ("push", "f8", 3),  # integral of the specific force, axes at the end of the interval [m/s]
        ("force_sum", "f8", 3),  # integral of the specific force in body axes, which turn [m/s]
        ("force", "f8", 3),  # the last specific force [m/s²]
        ("change", "f8", 3),  # of it from the one before [m/s²]
        ("shake", "f8"),  # mean square of its vibration, per axis [m²/s⁴]
        ("last_rate", "f8", 3),  # the last rate, low-passed [rad/s]
        ("rate_before", "f8", 3),  # the last one before the interval
        ("unseen", "f8"),  # variance of the unmeasured turn in the interval [rad²]
        ("rotor_time", "f8"),  # part of the interval with speeds of turning rotors [s]
        ("rotor_sum", "f8"),  # integral of Σ ω² over it [rad²/s]
        ("rotor_product", "f8"),  # mean of Σ ω² times the force along body z [rad² m/s⁴]
        ("rotor_square", "f8"),  # mean of (Σ ω²)² [rad⁴/s⁴]
    ]
)
"""The filter's state: models, their combination, and readings since their last update."""

PARAMETERS = {
    # Of a multirotor: coefficient k of rotor drag [1/s], quadratic drag f of the frame [1/m].
    "drag": Parameter(0.3, 0.1, 0.8, minimum=1e-3),
    "frame_drag": Parameter(0.01, 1e-3, 0.1, searched=False),
    # Least noise density of the drag measurement [m/s²·√s], and further in proportion to acceleration [√s].
    "drag_noise": Parameter(0.05, 5e-3, 0.1, minimum=1e-9),
    "model_noise": Parameter(0.004, 1e-3, 0.05),
    # Standard deviations of the velocity in flight, in the hand and at rest [m/s], its correlation time [s],
    # memory of the climb [s].
    "flight_speed": Parameter(3.0, 1.0, 10.0, minimum=1e-6),
    "hand_speed": Parameter(1.0, 0.1, 3.0, minimum=1e-6),
    "rest_speed": Parameter(0.1, 1e-2, 0.3, minimum=1e-6, searched=False),
    "speed_time": Parameter(1.0, 0.2, 3.0, minimum=1e-6),
    "climb_time": Parameter(2.0, 0.5, 5.0, minimum=0.05, searched=False),
    # Noise densities of the rate [rad/√s], of it in proportion to the rate (scale factor, misalignment) [√s],
    # of the specific force [m/s/√s], of the walks of wind [m/s/√s], biases [rad/s/√s], [m/s²/√s] and the
    # direction of thrust [rad/√s], and of the lever arm [m/√s], which takes up what the model lacks.
    "gyro_noise": Parameter(1e-3, 1e-4, 0.01),
    "turn_noise": Parameter(0.005, 1e-4, 0.05),
    "accel_noise": Parameter(0.01, 1e-3, 0.1, searched=False),
    "wind_noise": Parameter(1.0, 0.05, 5.0),
    "bias_noise": Parameter(3e-4, 1e-5, 1e-3),
    "accel_bias_noise": Parameter(0.003, 1e-4, 0.1),
    "offset_noise": Parameter(3e-4, 1e-5, 1e-2, searched=False),
    "lever_noise": Parameter(0.01, 1e-4, 0.1, searched=False),
    # Initial standard deviations: of the tilt [rad], of velocity and wind [m/s], of the biases
    # [rad/s], [m/s²], of the direction of thrust from body z [rad] and of the lever arm [m].
    "attitude_sigma": Parameter(0.3, 0.1, 0.6, searched=False),
    "speed_sigma": Parameter(3.0, 0.3, 10.0, searched=False),
    "wind_sigma": Parameter(4.0, 1.0, 10.0, searched=False),
    "bias_sigma": Parameter(0.05, 0.01, 0.2, searched=False),
    "accel_bias_sigma": Parameter(0.15, 0.02, 0.5, searched=False),
    "offset_sigma": Parameter(0.1, 0.01, 0.5, searched=False),
    "lever_sigma": Parameter(0.05, 1e-3, 0.3, searched=False),
    # At rest, as in `ekf_drag`: largest differences of the low-passes [rad/s], [m/s²], largest rate [rad/s],
    # noise density of the zero-rate update [rad/√s], time until it and of the fast low-pass [s].
    "rest_rate": Parameter(0.005, 1e-3, 0.1, searched=False),
    "rest_accel": Parameter(0.05, 0.01, 1.0, searched=False),
    "rest_rate_most": Parameter(0.1, 0.01, 1.0, searched=False),
    "rest_noise": Parameter(0.002, 1e-4, 0.1, minimum=1e-9, searched=False),
    "rest_delay": Parameter(1.5, 0.1, 5.0, minimum=1e-3, searched=False),
    "rest_fast": Parameter(0.1, 0.01, 1.0, minimum=1e-3, searched=False),
    # Least standard deviation of the horizontal acceleration in the hand [m/s²].
    "least_accel": Parameter(0.2, 0.01, 1.0, minimum=1e-6, searched=False),
    # Wind: ratio of the squared sum of its corrections to the sum of their squares at which its noise neither
    # rises nor falls, time in which it adapts, memories of the corrections and of a gust front [s], variances
    # that a low-passed innovation has there, and the least noise density [m/s/√s].
    "wind_share": Parameter(2.0, 1.0, 4.0, minimum=0.1),
    "wind_memory": Parameter(1.0, 0.3, 10.0, minimum=1e-3),
    "wind_window": Parameter(0.1, 0.02, 1.0, minimum=1e-3, searched=False),
    "gust_window": Parameter(0.04, 0.01, 0.5, minimum=1e-3, searched=False),
    "gust_ratio": Parameter(2.0, 1.5, 4.0, searched=False),
    "wind_noise_least": Parameter(0.02, 1e-4, 0.1, searched=False),
    # A step of the gyroscope's bias, which no recipe flies: variances that corrections of the tilt may sum
    # up to, and their memory [s]; standard deviation of the bias after it [rad/s].
    "step_ratio": Parameter(2.5, 1.5, 20.0, searched=False),
    "step_time": Parameter(2.0, 0.5, 10.0, minimum=1e-3, searched=False),
    "step_sigma": Parameter(0.05, 0.01, 0.2, searched=False),
    # Memories of mean squares and of vibration [s]. Time in which a force counts as one measurement of the
    # model; mean time until the model changes [s].
    "square_memory": Parameter(3.0, 0.5, 10.0, minimum=1e-3, searched=False),
    "vibration_memory": Parameter(0.5, 0.1, 5.0, minimum=1e-3, searched=False),
    "evidence_time": Parameter(0.5, 0.05, 10.0, minimum=1e-3),
    "sojourn_time": Parameter(30.0, 5.0, 200.0, minimum=1.0),
}
"""What a user or `quadsim tune` may change; units in the comments."""

PARAMS = parameter_record(PARAMETERS)
MODEL_HZ = 50.0
"""Rate at which the models take the readings [1/s]; readings of a lower rate are taken as they come."""
RECTIFIED = 0.1
"""Share of its vibration by which the mean of an accelerometer may shift."""
JERK_MAX = 2e4
"""Change of the specific force that no hand makes [m/s³]; one beyond it is missing for a sample."""
RATE_MEMORY = 0.005
"""Time constant of the low-pass before the rate's derivative [s]."""


@njit
def take_vibration(s, p, dt, change):
    """Take a change of the specific force [m/s²] into the mean square of its vibration.

    A second difference of white noise has six times its variance, and next to nothing of a motion.
    """
    square = 0.0
    for k in range(3):
        square += (change[k] - s.change[k]) ** 2 / 18.0
        s.change[k] = change[k]
    s.shake += (square - s.shake) * min(dt / p.vibration_memory, 1.0)


@njit
def accumulate(s, p, sample, rotor_square):
    """Take a `Sample` and the rotors' Σ ω² [rad²/s²] into the sums since the last update of the models."""
    dt, (gx, gy, gz), (ax, ay, az) = sample.dt, sample.gyro, sample.accel
    ew, ex, ey, ez = exp_core(gx * dt, gy * dt, gz * dt)
    tw, tx, ty, tz = s.turn
    s.turn[0], s.turn[1], s.turn[2], s.turn[3] = multiply_core(tw, tx, ty, tz, ew, ex, ey, ez)
    px, py, pz = s.push
    known = s.force[0] != 0.0 or s.force[1] != 0.0 or s.force[2] != 0.0
    change = (ax - s.force[0], ay - s.force[1], az - s.force[2])
    blow = known and not within(change[0], change[1], change[2], JERK_MAX * dt)
    if (ax != 0.0 or ay != 0.0 or az != 0.0) and not blow:
        if known:  # trapezoidal rule
            px, py, pz = px + 0.5 * dt * s.force[0], py + 0.5 * dt * s.force[1], pz + 0.5 * dt * s.force[2]
            px, py, pz = rotate_core(ew, -ex, -ey, -ez, px, py, pz)
            px, py, pz = px + 0.5 * dt * ax, py + 0.5 * dt * ay, pz + 0.5 * dt * az
            take_vibration(s, p, dt, change)
        else:
            px, py, pz = rotate_core(ew, -ex, -ey, -ez, px, py, pz)
            px, py, pz = px + dt * ax, py + dt * ay, pz + dt * az
        s.force_time += dt
        s.force_sum[0] += dt * ax
        s.force_sum[1] += dt * ay
        s.force_sum[2] += dt * az
    else:
        px, py, pz = rotate_core(ew, -ex, -ey, -ez, px, py, pz)
        ax = ay = az = 0.0
    s.push[0], s.push[1], s.push[2] = px, py, pz
    s.force[0], s.force[1], s.force[2] = ax, ay, az
    s.interval += dt
    s.time += dt
    s.unseen += sample.unseen
    if rotor_square > 0.0:
        s.rotor_time += dt
        s.rotor_sum += dt * rotor_square
    share = dt / (dt + RATE_MEMORY)
    s.last_rate[0] += share * (gx - s.last_rate[0])
    s.last_rate[1] += share * (gy - s.last_rate[1])
    s.last_rate[2] += share * (gz - s.last_rate[2])


@njit
def rotation_vector(turn):
    """Rotation vector of a quaternion of a turn of less than π [rad]."""
    length = math.sqrt(turn[1] ** 2 + turn[2] ** 2 + turn[3] ** 2)
    scale = 2.0 if length < 1e-9 else 2.0 * atan2_core(length, turn[0]) / length
    return scale * turn[1], scale * turn[2], scale * turn[3]


@njit
def share_heading(s):
    """Turn all models about the vertical to the likeliest one's heading; their tilts from it."""
    best = 0
    for k in range(COUNT):
        best = k if s.probability[k] > s.probability[best] else best
    bw, bx, by, bz = s.models[best].quat
    for k in range(COUNT):
        m = s.models[k]
        qw, qx, qy, qz = m.quat
        w, x, y, z = multiply_core(qw, qx, qy, qz, bw, -bx, -by, -bz)
        length = math.sqrt(w * w + z * z)
        cosine, sine = (w / length, z / length) if length > 0.0 else (1.0, 0.0)  # of half the heading
        m.quat[0], m.quat[1], m.quat[2], m.quat[3] = multiply_core(cosine, 0.0, 0.0, -sine, qw, qx, qy, qz)
        m.velocity[0], m.velocity[1], _ = rotate_core(
            cosine, 0.0, 0.0, -sine, m.velocity[0], m.velocity[1], 0.0
        )
        m.wind[0], m.wind[1], _ = rotate_core(cosine, 0.0, 0.0, -sine, m.wind[0], m.wind[1], 0.0)
        x, y = cosine * x + sine * y, cosine * y - sine * x
        across = math.sqrt(x * x + y * y)
        scale = 2.0 if across < 1e-9 else 2.0 * atan2_core(across, length) / across
        m.tilt[0], m.tilt[1] = scale * x, scale * y
    return best


@njit
def distance(m, s, d):
    """Error of a combined state against a model's, d (14,); `tilt` is from the combined attitude."""
    x, y, v = m.tilt[0], m.tilt[1], s.velocity
    d[TILT], d[TILT + 1] = x, y
    d[VELOCITY] = m.velocity[0] - v[0] - y * v[2]
    d[VELOCITY + 1] = m.velocity[1] - v[1] + x * v[2]
    for k in range(3):
        d[GYRO_BIAS + k] = m.gyro_bias[k] - s.gyro_bias[k]
    for k in range(2):
        d[ACCEL_BIAS + k] = m.accel_bias[k] - s.accel_bias[k]


@njit
def combine(s, d):
    """Mean and covariance over all models of what they share; d (14,) is scratch."""
    best = share_heading(s)
    x = y = 0.0
    s.velocity[:], s.gyro_bias[:], s.accel_bias[:] = 0.0, 0.0, 0.0
    s.covariance[:] = 0.0
    s.accel_square = 0.0
    for k in range(COUNT):
        m, share = s.models[k], s.probability[k]
        x, y = x + share * m.tilt[0], y + share * m.tilt[1]
        s.accel_square += share * m.accel_square
        for i in range(3):
            s.velocity[i] += share * m.velocity[i]
            s.gyro_bias[i] += share * m.gyro_bias[i]
        for i in range(2):
            s.accel_bias[i] += share * m.accel_bias[i]
    bw, bx, by, bz = s.models[best].quat
    s.quat[0], s.quat[1], s.quat[2], s.quat[3] = turned(bw, bx, by, bz, x, y)
    for k in range(COUNT):
        m, share = s.models[k], s.probability[k]
        m.tilt[0], m.tilt[1] = m.tilt[0] - x, m.tilt[1] - y
        distance(m, s, d)
        for i in range(SHARED):
            for j in range(SHARED):
                s.covariance[i, j] += share * (m.covariance[i, j] + d[i] * d[j])


@njit
def mix(s, p, change, d):
    """Move each model towards the combination by the share of its probability that comes from others."""
    for k in range(COUNT):
        m = s.models[k]
        share = change * (1.0 - s.probability[k])
        share /= share + s.probability[k]
        distance(m, s, d)
        own, both = 1.0 - share, share * (1.0 - share)
        for i in range(SHARED):
            for j in range(SHARED):
                m.covariance[i, j] = (
                    own * m.covariance[i, j] + share * s.covariance[i, j] + both * d[i] * d[j]
                )
        if k == MULTIROTOR:
            beyond = max(abs(m.wind[0]), abs(m.wind[1])) > SPEED_MAX
            forget_airframe(m, p, 1.0 if beyond else share)
        qw, qx, qy, qz = m.quat
        x, y = -share * m.tilt[0], -share * m.tilt[1]
        m.quat[0], m.quat[1], m.quat[2], m.quat[3] = turned(qw, qx, qy, qz, x, y)
        m.accel_square += share * (s.accel_square - m.accel_square)
        for i in range(3):
            m.velocity[i] += share * (s.velocity[i] - m.velocity[i])
            m.gyro_bias[i] += share * (s.gyro_bias[i] - m.gyro_bias[i])
        for i in range(2):
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


@njit
def weigh(s, evidence, change):
    """Probabilities after a measurement; evidence (m,) is the logarithm of its likelihood."""
    highest, total = max(evidence), 0.0
    for k in range(COUNT):
        prior = s.probability[k] + change * (1.0 - s.probability[k])
        evidence[k] = prior * math.exp(max(evidence[k] - highest, -300.0))
        total += evidence[k]
    for k in range(COUNT):
        s.probability[k] = evidence[k] / total


@njit
def update_models(s, p, work, evidence):
    """Take the interval that is over into all models, and combine them."""
    dt, d = s.interval, work[1]
    vector = rotation_vector(s.turn)
    known = s.force_time > 0.5 * dt
    scale = 1.0 / s.force_time if known else 0.0
    accel = (scale * s.push[0], scale * s.push[1], scale * s.push[2])
    body = (scale * s.force_sum[0], scale * s.force_sum[1], scale * s.force_sum[2])
    arm = ((s.last_rate[1] - s.rate_before[1]) / dt, (s.rate_before[0] - s.last_rate[0]) / dt)
    if s.time < 1.5 * dt:  # no rate before the first
        arm = (0.0, 0.0)
    s.rate_before[:] = s.last_rate
    rate = (vector[0] / dt, vector[1] / dt, vector[2] / dt)
    if s.begun == 0.0 and known:
        begin_at(s, accel)
    thrust = thrust_of_rotors(s, p, dt, body[2]) if known and s.rotor_time > 0.5 * dt else body[2]
    x, y = across_thrust(s.models[MULTIROTOR], body, arm)
    square = 0.5 * (x * x + y * y)
    s.body_square = (
        mean_square(s.body_square, square, dt, s.time, p.square_memory) if known else s.body_square
    )
    resting = known and at_rest(s, p, dt, rate, body)
    for k in range(COUNT):
        m = s.models[k]
        matrix = predict(m, k, s, p, vector, accel, known, work)
        evidence[k] = 0.0
        if known:
            evidence[k] = correct_model(m, k, s, p, resting, rate, accel, body, thrust, arm, matrix, work)
    change = dt / (COUNT * p.sojourn_time)
    weigh(s, evidence, change)
    combine(s, d)
    mix(s, p, change, d)
    s.interval = s.force_time = s.unseen = s.rotor_time = s.rotor_sum = 0.0
    s.turn[0], s.turn[1:], s.push[:] = 1.0, 0.0, 0.0
    s.force_sum[:] = 0.0


@njit
def thrust_of_rotors(s, p, dt, along):
    """Thrust per mass by rotor speeds, κ Σ ω² [m/s²]; κ by least squares from the force along body z.

    Args:
        s: The filter's record.
        p: Its parameters.
        dt: Length of the interval [s].
        along: Mean force along body z in it [m/s²].
    """
    square = s.rotor_sum / s.rotor_time
    s.rotor_product = mean_square(s.rotor_product, square * along, dt, s.time, p.square_memory)
    s.rotor_square = mean_square(s.rotor_square, square * square, dt, s.time, p.square_memory)
    return square * s.rotor_product / s.rotor_square


@njit
def begin_at(s, accel):
    """Start all models at the tilt at which the first force is vertical."""
    x, y = tilt_core(accel[0], accel[1], accel[2])
    for k in range(COUNT):
        m = s.models[k]
        qw, qx, qy, qz = m.quat
        m.quat[0], m.quat[1], m.quat[2], m.quat[3] = turned(qw, qx, qy, qz, x, y)
    s.begun = 1.0


@njit
def begin(s, p, known):
    """Put a record, whose attitude is there, at the start: known, or level until the first force."""
    s.begun = 1.0 if known else 0.0
    s.turn[0] = 1.0
    s.probability[:] = 1.0 / COUNT
    for k in range(COUNT):
        m = s.models[k]
        m.quat[:] = s.quat
        P = m.covariance
        P[:] = 0.0
        for i in range(ERRORS):
            sigma = p.lever_sigma if i == LEVER else p.offset_sigma
            if i < VELOCITY:
                sigma = p.attitude_sigma  # a start that is given may be wrong, and would pass for a bias
            elif i < GYRO_BIAS:
                sigma = p.speed_sigma
            elif i < ACCEL_BIAS:
                sigma = p.bias_sigma
            elif i < WIND:
                sigma = p.accel_bias_sigma
            elif i < OFFSET:
                sigma = p.wind_sigma
            P[i, i] = sigma**2
        m.wind_noise = p.wind_noise**2
        s.covariance[:] = P[:SHARED, :SHARED]


@njit
def inverted(s, p):
    """Whether the vertical velocity shows that the estimate is upside down, as it may be after a gap.

    With the memory τ = `climb_time`, that of a vehicle in free fall tends to −g τ, and that of an estimate
    which takes thrust for a pull towards the ground to −2 g τ.
    """
    return s.velocity[2] < -GRAVITY * p.climb_time


@njit
def step(s, own, p, sample, rotor_square, work):
    """See `algorithm`; a filter that has diverged starts again."""
    accumulate(s, p, sample, rotor_square)
    if s.interval >= 1.0 / MODEL_HZ - 0.5 * sample.dt:
        update_models(s, p, *work)
        if diverged(s.gyro_bias, s.velocity) or inverted(s, p):
            own[:] = 0.0
            s.quat[0] = 1.0
            begin(s, p, False)
    else:
        turn_on(s, sample)
    return roll_pitch_core(s.quat[0], s.quat[1], s.quat[2], s.quat[3])


@njit
def turn_on(s, sample):
    """Turn the combined attitude by a sample, until the models have taken it."""
    b, dt, (gx, gy, gz) = s.gyro_bias, sample.dt, sample.gyro
    ew, ex, ey, ez = exp_core((gx - b[0]) * dt, (gy - b[1]) * dt, (gz - b[2]) * dt)
    qw, qx, qy, qz = s.quat
    s.quat[0], s.quat[1], s.quat[2], s.quat[3] = multiply_core(qw, qx, qy, qz, ew, ex, ey, ez)


@njit
def room():
    """Scratch: (14, 14); the error dx, a column of P, process noise (14,); innovation (2,); evidence (m,)."""
    work = np.empty((ERRORS, ERRORS)), np.empty(ERRORS), np.empty(ERRORS), np.empty(ERRORS), np.empty(2)
    return work, np.empty(COUNT)


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, rotor_vel, out):
    """See `algorithm`."""
    sequence_of(step, False, room(), states, params, dt, (gyro, accel, rotor_vel), out)


@njit(cache=True, nogil=True)
def score(states, params, dt, flights):
    """See `algorithm`."""
    return score_of(step, False, room(), states, params, dt, flights)


@njit(cache=True)
def _begin(states, params, known):
    for i in range(len(states)):
        begin(states[i], params[i], known)


def _start(states: Records, quat: Array, known: bool, params: Records) -> None:
    states["quat"] = quat
    _begin(states, params, known)


def tilt_covariance(states: Records) -> Array:
    """That of the models and, on both axes, of the mean force, which vibration shifts, (n, 2, 2) [rad²]."""
    shifted = (RECTIFIED / GRAVITY) ** 2 * states["shake"]
    return tilt_block(states) + shifted[:, None, None] * np.eye(2)


IMM = Algorithm("imm", PARAMETERS, STATE, PARAMS, sequence, score, _start, ("rotor_vel",), tilt_covariance)


class InteractingModels(Filter):
    """The filter of n vehicles, with the models that it believes; its σ is of their last update."""

    models = MODELS
    """Names of the models, in the order of `model_probability`."""

    @property
    def model_probability(self) -> Array:
        """Probability of each model, (n, 3); a row sums to 1."""
        return self._states["probability"].copy()
