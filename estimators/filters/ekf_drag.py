"""Error-state Kalman filter that is given the airframe's drag, and adapts its noise to its innovations.

Without drag the accelerometer of a flying quadrotor reads thrust along body z at any tilt. The part
across it is rotor and frame drag, so it measures velocity through the air, not tilt (Martin & Salaün, "The
true role of accelerometer feedback in quadrotor control", ICRA 2010; Leishman et al., "Quadrotors and
accelerometers", IEEE Control Systems 34(1), 2014). Tilt then follows from how that velocity changes.

State: attitude R, velocity v and horizontal wind w (world axes), gyroscope bias b, accelerometer bias c:

    Ṙ = R [ω − b]×,    v̇ = R (a − c) + g,    ẇ, ḃ, ċ random walks,
    a_xy = −D (Rᵀ (v − w))_xy + c_xy + noise,    D = √(a_z / g) / τ + f |v − w|

because rotor drag is proportional to the sum of rotor speeds, which goes with the root of thrust; τ is the
time constant of rotor drag at hover and f the frame's quadratic drag per mass, both from the vehicle's file.
A second, weak measurement says that the vehicle stays where it is on the whole: v = 0.

The error is right-invariant as in `eskf`: θ in world axes, v = exp([θ]×) v̂ + δv and so for w. The drag
measurement then does not depend on θ at all, its matrix is −D R̂ᵀ on δv − δw, and heading drops out. Error
state: θ_x, θ_y, δv, δw_x, δw_y, δb, δc (13).

Noise is adapted to the innovation ν of the drag measurement, whose matrix is H:

- *Vibration*: the variance of ν is at least the low-passed ¼ |ν[t] − ν[t−1]|², the part that is white.
- *Wind*: corrections of the airspeed v − w that sum up to more than the variance they remove raise the
  process noise of w, less lowers it (Myers & Tapley, "Adaptive sequential estimation with unknown noise
  statistics", IEEE Trans. Autom. Control 21(4), 1976).
- *Gust fronts*: a low-passed ν beyond its own variance inflates that process noise at once.
- *Bias steps*: corrections of b that sum up to far more than the variance they remove inflate the variance
  of b.
- *Velocity*: the measurement v = 0 is the weaker, the larger the mean square of the estimated velocity.
- *Model*: the variance of ν grows with the mean square of the horizontal acceleration, since thrust and drag
  are not known exactly.

At rest, where low-passes of all six readings with two time constants agree, the gyroscope measures its bias
(a zero-rate update, as in VQF: Laidig & Seel, "VQF: Highly accurate IMU orientation estimation with bias
estimation and magnetic disturbance rejection", Information Fusion 91, 2023).
"""

import math

import numpy as np

from quadsim.rotation import from_rotvec_core, matrix_core, multiply_core, rotate_core
from quadsim.runs.compiled import njit
from quadsim.vehicle import AIR_DENSITY, GRAVITY, Vehicle

from .algorithm import (
    FROM_VEHICLE,
    Algorithm,
    Array,
    Parameter,
    Records,
    score_of,
    sequence_of,
    tilt_block,
)
from .ekf import SIGMA_KNOWN
from .eskf import turned
from .inline_math import roll_pitch_core
from .samples import parameter_record

ERRORS = 13
TILT, VELOCITY, WIND, GYRO_BIAS, ACCEL_BIAS = 0, 2, 5, 7, 10
"""Where the parts of the error state begin."""
WIDTH, TURNED = 16, 8
"""Columns of arrays over the error state, and over its part that moves with attitude, padded with zeros to
whole vector registers: the compiler then makes vector instructions of the loops over them."""

STATE = np.dtype(
    [
        ("quat", "f8", 4),
        ("velocity", "f8", 3),
        ("wind", "f8", 2),
        ("gyro_bias", "f8", 3),
        ("accel_bias", "f8", 3),
        ("covariance", "f8", (ERRORS, WIDTH)),
        ("time", "f8"),  # since the start [s]
        ("accel_W", "f8", 3),  # of the last sample, world axes [m/s²]
        ("innovation", "f8", 2),  # of the drag measurement at the last sample, world axes [m/s²]
        ("innovation_mean", "f8", 2),  # low-passed [m/s²]
        ("vibration", "f8"),  # variance of the white part of it [m²/s⁴]
        ("wind_noise", "f8"),  # process noise of the wind [m²/s³]
        ("airspeed_sum", "f8", 2),  # recent corrections of v - w [m/s]
        ("airspeed_due", "f8"),  # variance that they removed [m²/s²]
        ("bias_sum", "f8", 3),  # recent corrections of the gyroscope's bias [rad/s]
        ("bias_due", "f8"),  # variance that they removed [rad²/s²]
        ("speed_square", "f8"),  # mean square of the horizontal velocity, per axis [m²/s²]
        ("accel_square", "f8"),  # mean square of the horizontal acceleration [m²/s⁴]
        ("rest_time", "f8"),  # for which the readings have not changed [s]
        ("fast", "f8", 6),  # low-passed readings
        ("slow", "f8", 6),
        # Scratch of a sample, here because the compiler knows that fields of one record do not overlap.
        ("moved", "f8", (ERRORS, TURNED)),  # columns of F P Fᵀ that F changes
        ("error", "f8", WIDTH),  # estimated so far
        ("columns", "f8", (5, WIDTH)),  # P hᵀ of each measurement, P being reduced by those before it
        ("gains", "f8", (5, WIDTH)),
    ]
)
"""The filter's state."""

PARAMETERS = {
    # Least noise density of the drag measurement [m/s²·√s], and further in proportion to acceleration [√s].
    "drag_noise": Parameter(0.015, 5e-3, 0.05, minimum=1e-9),
    "model_noise": Parameter(0.004, 2e-3, 0.02),
    # Wind: initial noise density [m/s/√s]; gain of its adaptation, share of the removed variance at which it
    # neither rises nor falls, its memory [s]; variances that a low-passed innovation has at a gust front.
    "wind_noise": Parameter(0.17, 0.05, 0.5),
    "wind_gain": Parameter(1.0, 0.2, 3.0, searched=False),
    "wind_share": Parameter(0.6, 0.3, 0.9, searched=False),
    "wind_memory": Parameter(15.0, 3.0, 40.0, minimum=1e-3, searched=False),
    "gust_ratio": Parameter(2.0, 1.5, 4.0, searched=False),
    # The measurement v = 0: least standard deviation [m/s], correlation time [s], its growth with the mean
    # square of the velocity [s²/m²], memory of that square [s]; noise density of the climb [m/s·√s].
    "speed_least": Parameter(0.2, 0.05, 0.6, minimum=1e-6),
    "speed_time": Parameter(0.33, 0.15, 1.5, minimum=1e-6),
    "speed_growth": Parameter(10.9, 1.0, 50.0, searched=False),
    "speed_memory": Parameter(2.0, 0.3, 5.0, minimum=1e-3, searched=False),
    "climb_noise": Parameter(2.0, 0.5, 5.0, minimum=1e-9),
    # Initial standard deviations: of an unknown tilt [rad], of velocity and of wind [m/s].
    "attitude_sigma": Parameter(0.3, 0.15, 0.6),
    "speed_sigma": Parameter(0.6, 0.3, 3.0),
    "wind_sigma": Parameter(4.0, 1.0, 10.0, searched=False),
    # Not searched: noise densities of the rate [rad/√s] and of the specific force [m/s/√s], of the walks of
    # both biases [rad/s/√s], [m/s²/√s], and the least of the wind [m/s/√s].
    "gyro_noise": Parameter(1e-3, 1e-4, 0.01, searched=False),
    "accel_noise": Parameter(0.01, 1e-3, 0.1, searched=False),
    "bias_noise": Parameter(3e-4, 1e-6, 1e-3, searched=False),
    "accel_bias_noise": Parameter(0.0085, 1e-4, 0.1, searched=False),
    "wind_noise_least": Parameter(0.013, 1e-4, 0.1, searched=False),
    # Memories of the wind's corrections, of a gust front, of vibration and of acceleration [s].
    "wind_window": Parameter(0.1, 0.02, 1.0, minimum=1e-3, searched=False),
    "gust_window": Parameter(0.04, 0.01, 0.5, minimum=1e-3, searched=False),
    "vibration_memory": Parameter(0.5, 0.1, 5.0, minimum=1e-3, searched=False),
    "accel_memory": Parameter(2.7, 0.5, 10.0, minimum=1e-3, searched=False),
    # A step of the gyroscope's bias, which no recipe flies: variances that its corrections may sum up to
    # before one is detected, gain of the inflation, memory of the sum [s].
    "step_ratio": Parameter(2.5, 1.5, 20.0, searched=False),
    "step_gain": Parameter(40.0, 1.0, 200.0, searched=False),
    "step_window": Parameter(1.0, 0.1, 5.0, minimum=1e-3, searched=False),
    # At rest: largest differences of the low-passes [rad/s], [m/s²], largest rate [rad/s], noise density of
    # the zero-rate update [rad/√s], time until it (and of the slow low-pass) and of the fast low-pass [s].
    "rest_rate": Parameter(0.005, 1e-3, 0.1, searched=False),
    "rest_accel": Parameter(0.05, 0.01, 1.0, searched=False),
    "rest_rate_most": Parameter(0.1, 0.01, 1.0, searched=False),
    "rest_noise": Parameter(0.002, 1e-4, 0.1, minimum=1e-9, searched=False),
    "rest_delay": Parameter(1.5, 0.1, 5.0, minimum=1e-3, searched=False),
    "rest_fast": Parameter(0.1, 0.01, 1.0, minimum=1e-3, searched=False),
    # Of the IMU: initial standard deviations of the biases [rad/s], [m/s²]. Of the vehicle: τ [s], f [1/m].
    "bias_sigma": Parameter(0.0087, 1e-4, 0.1, searched=False),
    "accel_bias_sigma": Parameter(0.196, 1e-3, 1.0, searched=False),
    "drag_time": Parameter(FROM_VEHICLE, 1.0, 20.0, minimum=1e-3, searched=False),
    "frame_drag": Parameter(FROM_VEHICLE, 1e-4, 1.0, searched=False),
}
"""What a user or `quadsim tune` may change; units in the comments."""

PARAMS = parameter_record(PARAMETERS)

INNOVATION_MAX = 5.0
"""Innovations count no further: one bad reading does no lasting harm [m/s²]."""
GAP_SPEED = 3.0
"""Change of velocity in a gap, for each radian that may have been turned unseen [m/s]."""
BIAS_MAX = math.radians(30.0)
"""Bias that no gyroscope has [rad/s]; a filter that estimates one has diverged, and starts again."""
SPEED_MAX = 60.0
"""The same of a velocity or a wind [m/s]."""
FIRST_S = 0.1
"""Time for which the first value of a mean square counts [s]."""


@njit
def transition(P, width, matrix, v, w, dt):
    """P ← F P of (13, width), with θ̇ = −R̂ δb, δv̇ = −θ × g − R̂ δc − v̂ × R̂ δb and δẇ = −ŵ × R̂ δb."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = matrix
    vx, vy, vz, wx, wy = v[0], v[1], v[2], w[0], w[1]
    for j in range(width):
        x, y = P[TILT, j], P[TILT + 1, j]
        b0, b1, b2 = P[GYRO_BIAS, j], P[GYRO_BIAS + 1, j], P[GYRO_BIAS + 2, j]
        c0, c1, c2 = P[ACCEL_BIAS, j], P[ACCEL_BIAS + 1, j], P[ACCEL_BIAS + 2, j]
        # R̂ δb and R̂ δc
        bx, cx = r00 * b0 + r01 * b1 + r02 * b2, r00 * c0 + r01 * c1 + r02 * c2
        by, cy = r10 * b0 + r11 * b1 + r12 * b2, r10 * c0 + r11 * c1 + r12 * c2
        bz, cz = r20 * b0 + r21 * b1 + r22 * b2, r20 * c0 + r21 * c1 + r22 * c2
        P[TILT, j] = x - dt * bx
        P[TILT + 1, j] = y - dt * by
        P[VELOCITY, j] += dt * (GRAVITY * y - cx - (vy * bz - vz * by))
        P[VELOCITY + 1, j] += dt * (-GRAVITY * x - cy - (vz * bx - vx * bz))
        P[VELOCITY + 2, j] += dt * (-cz - (vx * by - vy * bx))
        P[WIND, j] -= dt * wy * bz
        P[WIND + 1, j] += dt * wx * bz


@njit
def propagate(s, matrix, dt, walks):
    """P ← F P Fᵀ + Q for a symmetric P, of which F leaves the biases' block as it is.

    Args:
        s: The vehicle's record.
        matrix: R̂ by rows.
        dt: Sample period [s].
        walks: Variances that a sample adds to θ, v, w, b and c.
    """
    P, T, v, w = s.covariance, s.moved, s.velocity, s.wind
    transition(P, WIDTH, matrix, v, w, dt)
    for i in range(GYRO_BIAS):
        for j in range(ERRORS):
            T[j, i] = P[i, j]
    transition(T, TURNED, matrix, v, w, dt)
    for i in range(ERRORS):
        for j in range(GYRO_BIAS):
            P[i, j] = T[i, j]
    for i in range(ERRORS):
        P[i, i] += walks[(i >= VELOCITY) + (i >= WIND) + (i >= GYRO_BIAS) + (i >= ACCEL_BIAS)]


@njit
def along_drag(x, y, z, k, error):
    """What the drag measurement of axis k changes by with an error (13,), given row k of −D R̂ᵀ."""
    across = x * (error[VELOCITY] - error[WIND]) + y * (error[VELOCITY + 1] - error[WIND + 1])
    return across + z * error[VELOCITY + 2] + error[ACCEL_BIAS + k]


@njit
def along_velocity(x, y, k, error):
    """What the velocity along axis k changes by with an error (13,), given the row of θ × v̂ on θ."""
    return x * error[TILT] + y * error[TILT + 1] + error[VELOCITY + k]


@njit(error_model="numpy")
def correct(s, k, total, residual):
    """Add scalar measurement k with row h to the error; P is reduced by all of them in `reduce_covariance`.

    Args:
        s: The vehicle's record; row k of `columns` holds P hᵀ. Writes row k of `gains`.
        k: Which measurement.
        total: h P hᵀ and the measurement's variance.
        residual: Measured less expected, less h on the error so far.
    """
    share = 1.0 / total
    for a in range(WIDTH):
        s.gains[k, a] = share * s.columns[k, a]
        s.error[a] += s.gains[k, a] * residual


@njit
def reduce_covariance(s):
    """P less what its five measurements removed."""
    P, c = s.covariance, s.columns
    for a in range(ERRORS):
        g0, g1, g2, g3, g4 = s.gains[0, a], s.gains[1, a], s.gains[2, a], s.gains[3, a], s.gains[4, a]
        for b in range(WIDTH):
            P[a, b] -= g0 * c[0, b] + g1 * c[1, b] + g2 * c[2, b] + g3 * c[3, b] + g4 * c[4, b]


@njit
def correct_by_drag(s, accel, drag, variance, matrix):
    """Correct by the specific force across thrust, axis after axis: measurements 0 and 1.

    Args:
        s: The vehicle's record.
        accel: Specific force (3,) [m/s²].
        drag: D [1/s].
        variance: Of the measurement, each axis [m²/s⁴].
        matrix: R̂ by rows.

    Returns:
        The innovation in body axes before the correction, two numbers [m/s²].
    """
    P, c, dx = s.covariance, s.columns, s.error
    v, w = s.velocity, s.wind
    first = innovation = 0.0
    for k in range(2):
        x, y, z = -drag * matrix[k], -drag * matrix[3 + k], -drag * matrix[6 + k]
        expected = x * (v[0] - w[0]) + y * (v[1] - w[1]) + z * v[2] + s.accel_bias[k]
        innovation = min(max(accel[k] - expected, -INNOVATION_MAX), INNOVATION_MAX)
        for a in range(WIDTH):
            across = x * (P[VELOCITY, a] - P[WIND, a]) + y * (P[VELOCITY + 1, a] - P[WIND + 1, a])
            c[k, a] = across + z * P[VELOCITY + 2, a] + P[ACCEL_BIAS + k, a]
        if k == 0:
            first = innovation
        else:
            shared = along_drag(x, y, z, k, c[0])
            for a in range(WIDTH):
                c[1, a] -= shared * s.gains[0, a]
        correct(s, k, along_drag(x, y, z, k, c[k]) + variance, innovation - along_drag(x, y, z, k, dx))
    return first, innovation


@njit
def correct_by_zero_velocity(s, speed_variance, climb_variance):
    """Correct by the measurement v = 0, axis after axis: measurements 2, 3 and 4."""
    P, c, v = s.covariance, s.columns, s.velocity
    for k in range(3):
        x, y = 0.0, 0.0  # of θ × v̂
        if k == 0:
            y = v[2]
        elif k == 1:
            x = -v[2]
        else:
            x, y = v[1], -v[0]
        for a in range(WIDTH):
            c[2 + k, a] = x * P[TILT, a] + y * P[TILT + 1, a] + P[VELOCITY + k, a]
        for j in range(2 + k):
            shared = along_velocity(x, y, k, c[j])
            for a in range(WIDTH):
                c[2 + k, a] -= shared * s.gains[j, a]
        total = along_velocity(x, y, k, c[2 + k]) + (climb_variance if k == 2 else speed_variance)
        correct(s, 2 + k, total, -v[k] - along_velocity(x, y, k, s.error))


@njit
def correct_by_zero_rate(s, gyro, variance):
    """Correct by the gyroscope of a vehicle at rest, which reads its bias, and reduce P at once."""
    P, c = s.covariance, s.columns
    for k in range(GYRO_BIAS, ACCEL_BIAS):
        for a in range(WIDTH):
            c[0, a] = P[k, a]
        correct(s, 0, c[0, k] + variance, gyro[k - GYRO_BIAS] - s.gyro_bias[k - GYRO_BIAS] - s.error[k])
        for a in range(ERRORS):
            for b in range(WIDTH):
                P[a, b] -= s.gains[0, a] * c[0, b]


@njit
def removed_by_drag(s):
    """Variance that the drag measurements removed, axes summed: of v − w [m²/s²], and of b [rad²/s²]."""
    airspeed, bias, columns, gains = 0.0, 0.0, s.columns, s.gains
    for k in range(2):
        for a in range(2):
            gain = gains[k, VELOCITY + a] - gains[k, WIND + a]
            airspeed += gain * (columns[k, VELOCITY + a] - columns[k, WIND + a])
        for a in range(GYRO_BIAS, ACCEL_BIAS):
            bias += gains[k, a] * columns[k, a]
    return airspeed, bias


@njit
def adapt_vibration(s, p, dt, x, y):
    """Take an innovation in world axes into its mean and into the variance of its white part."""
    if s.time > dt:
        change = (x - s.innovation[0]) ** 2 + (y - s.innovation[1]) ** 2
        s.vibration += (0.25 * change - s.vibration) * dt / p.vibration_memory
    s.innovation[0], s.innovation[1] = x, y
    s.innovation_mean[0] += (x - s.innovation_mean[0]) * dt / p.gust_window
    s.innovation_mean[1] += (y - s.innovation_mean[1]) * dt / p.gust_window


@njit
def adapt_wind(s, p, dt, moved, removed):
    """Take a correction of the airspeed (2,), and the variance that it removed, into the wind's noise."""
    scatter = 0.0
    for k in range(2):
        s.airspeed_sum[k] += moved[k] - s.airspeed_sum[k] * dt / p.wind_window
        scatter += 0.5 * s.airspeed_sum[k] ** 2
    s.airspeed_due += max(0.5 * removed, 0.0) - 2.0 * s.airspeed_due * dt / p.wind_window
    excess = p.wind_gain * 2.0 * (scatter - p.wind_share * s.airspeed_due) / p.wind_window
    memory = min(0.5 * FIRST_S + s.time, p.wind_memory) if excess > 0.0 else p.wind_memory
    s.wind_noise = max(s.wind_noise + excess * dt / memory, p.wind_noise_least**2)


@njit
def adapt_bias(s, p, dt, removed):
    """Inflate the variance of the gyroscope's bias where its corrections show that it has stepped."""
    scatter = 0.0
    for k in range(3):
        s.bias_sum[k] += s.error[GYRO_BIAS + k] - s.bias_sum[k] * dt / p.step_window
        scatter += s.bias_sum[k] ** 2 / 3.0
    s.bias_due += max(removed, 0.0) / 3.0 - 2.0 * s.bias_due * dt / p.step_window
    inflation = max(scatter - p.step_ratio * s.bias_due, 0.0) * p.step_gain * dt / p.step_window
    for k in range(GYRO_BIAS, ACCEL_BIAS):
        s.covariance[k, k] += inflation


@njit
def gust_noise(s, p, noise, dt, drag):
    """Process noise of the wind by a low-passed innovation beyond its variance [m²/s³]."""
    square = s.innovation_mean[0] ** 2 + s.innovation_mean[1] ** 2
    return max(square - p.gust_ratio * noise * dt / p.gust_window, 0.0) / p.gust_window / (drag * drag)


@njit
def at_rest(s, p, dt, gyro, accel):
    """Take readings into their low-passes; whether they have agreed for long enough."""
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
def mean_square(value, square, dt, time, memory):
    """Mean square after a further square value."""
    return value + (square - value) * dt / min(FIRST_S + time, memory)


@njit
def measure(s, p, sample, quat, matrix):
    """All corrections by one sample: adds to the error, reduces the covariance, adapts the noise."""
    v, w, dt, gyro, accel = s.velocity, s.wind, sample.dt, sample.gyro, sample.accel
    speed = math.sqrt((v[0] - w[0]) ** 2 + (v[1] - w[1]) ** 2 + v[2] ** 2)
    drag = math.sqrt(max(accel[2], 0.0) / GRAVITY) / p.drag_time + p.frame_drag * speed
    noise = max(s.vibration, p.drag_noise**2 / dt)
    variance = noise + p.model_noise**2 * s.accel_square / dt
    along, across = correct_by_drag(s, accel, drag, variance, matrix)
    x, y, _ = rotate_core(quat[0], quat[1], quat[2], quat[3], along, across, 0.0)
    adapt_vibration(s, p, dt, x, y)
    if s.time > p.wind_window:  # the first corrections are those of the initial state
        airspeed, bias = removed_by_drag(s)
        moved = s.error[VELOCITY] - s.error[WIND], s.error[VELOCITY + 1] - s.error[WIND + 1]
        adapt_wind(s, p, dt, moved, airspeed)
        adapt_bias(s, p, dt, bias)
    density = max(s.speed_square, p.speed_least**2) * p.speed_time * (1.0 + p.speed_growth * s.speed_square)
    correct_by_zero_velocity(s, density / dt, p.climb_noise**2 / dt)
    reduce_covariance(s)
    s.speed_square = mean_square(s.speed_square, 0.5 * (v[0] ** 2 + v[1] ** 2), dt, s.time, p.speed_memory)
    if at_rest(s, p, dt, gyro, accel):
        correct_by_zero_rate(s, gyro, p.rest_noise**2 / dt)


@njit
def advance(s, p, sample):
    """Take one `Sample`; s is a vehicle's record, p its parameters."""
    dx, v, w, b, c = s.error, s.velocity, s.wind, s.gyro_bias, s.accel_bias
    dt, gyro, accel, unseen = sample.dt, sample.gyro, sample.accel, sample.unseen
    s.time += dt
    noise = max(s.vibration, p.drag_noise**2 / dt)
    wind_noise = max(s.wind_noise, gust_noise(s, p, noise, dt, 1.0 / p.drag_time))
    walks = (
        p.gyro_noise**2 * dt + unseen,
        p.accel_noise**2 * dt + GAP_SPEED**2 * unseen,
        wind_noise * dt,
        p.bias_noise**2 * dt,
        p.accel_bias_noise**2 * dt,
    )
    turn = from_rotvec_core((gyro[0] - b[0]) * dt, (gyro[1] - b[1]) * dt, (gyro[2] - b[2]) * dt)
    qw, qx, qy, qz = s.quat
    qw, qx, qy, qz = multiply_core(qw, qx, qy, qz, turn[0], turn[1], turn[2], turn[3])
    matrix = matrix_core(qw, qx, qy, qz)
    propagate(s, matrix, dt, walks)
    dx[:] = 0.0
    if accel[0] != 0.0 or accel[1] != 0.0 or accel[2] != 0.0:
        fx, fy, fz = rotate_core(qw, qx, qy, qz, accel[0] - c[0], accel[1] - c[1], accel[2] - c[2])
        now = (fx, fy, fz - GRAVITY)
        for k in range(3):  # trapezoidal rule
            v[k] += 0.5 * (now[k] + (s.accel_W[k] if s.time > dt else now[k])) * dt
            s.accel_W[k] = now[k]
        s.accel_square = mean_square(s.accel_square, fx * fx + fy * fy, dt, s.time, p.accel_memory)
        measure(s, p, sample, (qw, qx, qy, qz), matrix)
    qw, qx, qy, qz = turned(qw, qx, qy, qz, dx[TILT], dx[TILT + 1])
    s.quat[0], s.quat[1], s.quat[2], s.quat[3] = qw, qx, qy, qz
    rw, rx, ry, rz = from_rotvec_core(dx[TILT], dx[TILT + 1], 0.0)
    v[0], v[1], v[2] = rotate_core(rw, rx, ry, rz, v[0], v[1], v[2])
    w[0], w[1], _ = rotate_core(rw, rx, ry, rz, w[0], w[1], 0.0)
    for k in range(3):
        v[k] += dx[VELOCITY + k]
        b[k] += dx[GYRO_BIAS + k]
        c[k] += dx[ACCEL_BIAS + k]
    w[0], w[1] = w[0] + dx[WIND], w[1] + dx[WIND + 1]
    return roll_pitch_core(qw, qx, qy, qz)


@njit
def diverged(gyro_bias, velocity):
    """Whether an estimate is beyond what can be; a NaN is."""
    possible = True
    for value in gyro_bias:
        possible &= abs(value) <= BIAS_MAX
    for value in velocity:
        possible &= abs(value) <= SPEED_MAX
    return not possible


@njit
def begin(s, p, known):
    """Put a record, whose attitude is there, at the start: known, or level with an unknown tilt."""
    P = s.covariance
    P[:] = 0.0
    for k in range(ERRORS):
        sigma = p.accel_bias_sigma
        if k < VELOCITY:
            sigma = SIGMA_KNOWN if known else p.attitude_sigma
        elif k < WIND:
            sigma = p.speed_sigma
        elif k < GYRO_BIAS:
            sigma = p.wind_sigma
        elif k < ACCEL_BIAS:
            sigma = p.bias_sigma
        P[k, k] = sigma**2
    s.wind_noise, s.speed_square = p.wind_noise**2, p.speed_sigma**2


@njit
def step(s, own, p, sample, _rotor_square, _work):
    """See `algorithm`; a filter that has diverged starts again, level."""
    roll_pitch = advance(s, p, sample)
    if diverged(s.gyro_bias, s.velocity) or diverged(s.gyro_bias, s.wind):
        own[:] = 0.0
        s.quat[0] = 1.0
        begin(s, p, False)
        return 0.0, 0.0
    return roll_pitch


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out):
    """See `algorithm`."""
    readings = gyro, accel, np.empty((*gyro.shape[:2], 0))
    sequence_of(step, True, (), states, params, dt, readings, out)


@njit(cache=True, nogil=True)
def score(states, params, dt, flights):
    """See `algorithm`."""
    return score_of(step, True, (), states, params, dt, flights)


@njit(cache=True)
def _begin(states, params, known):
    for i in range(len(states)):
        begin(states[i], params[i], known)


def _start(states: Records, quat: Array, known: bool, params: Records) -> None:
    states["quat"] = quat
    _begin(states, params, known)


EKF_DRAG = Algorithm(
    "ekf-drag", PARAMETERS, STATE, PARAMS, sequence, score, _start, tilt_covariance=tilt_block
)


def drag_of(vehicle: Vehicle) -> dict[str, float]:
    """`drag_time` and `frame_drag` of a vehicle."""
    area = 0.5 * (vehicle.frame.drag_area[0] + vehicle.frame.drag_area[1])
    return {
        "drag_time": vehicle.drag_time_constant,
        "frame_drag": 0.5 * AIR_DENSITY * area / vehicle.mass,
    }
