"""Interacting multiple models: a filter that needs no vehicle data.

Blom & Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Trans. Autom. Control 33(8), 1988. There are three hypotheses about the carrier of the
IMU. Each is a Kalman filter (`imm_model`) with probability μ:

    multirotor    the force perpendicular to thrust is drag; v = 0 within several m/s
    free          any carrier with v = 0 within several m/s
    hand          a slower carrier, with v = 0 within 1 m/s

The likelihood Λ of a model is the product of

- the density of a force that should be small: for a multirotor, the force perpendicular to thrust; for the
  others, the horizontal force in world axes by the model's attitude. The variance of each force is its own
  mean square over some seconds, so that the smaller force is more likely. Because such forces are not white,
  their logarithm counts once per `evidence_time`;
- the density of the velocity, once per `speed_time`.

All densities are Student's t. The true model changes at random, on average once per `sojourn_time`, to each
other model at the same rate:

    ε_j = dt / (3 sojourn_time) (1 − μ_j),    μ_j ← (μ_j + ε_j) Λ_j / Σ

Mixing then moves model j towards the combination of all models by the share ε_j / (μ_j + ε_j). A probable
model hardly moves; an improbable model moves to the combination and can therefore take over. Wind, direction
of thrust and lever arm, which only multirotors have, are mixed with their initial values by this share.

When the sensors are at rest, all models take a velocity of zero and the gyroscope's reading as its bias, as
`ekf_drag` does.

Heading is not observable: all models are rotated about the vertical to the heading of the most probable one.
Readings are integrated at their own rate to a rotation and a change of velocity (Savage, "Strapdown inertial
navigation integration algorithm design", J. Guidance 21, 1998), which the models process at `MODEL_HZ`. In
between, the combined attitude rotates with the gyroscope.

Rotor speeds ω are optional in every sample. If they are given, the thrust in the drag is κ Σ ω² instead of
the force along body z, which vibration disturbs. The factor κ is estimated: the least-squares ratio of this
force to Σ ω² over `square_memory`. If a speed is missing or the rotors stand still, the force is used.
"""

import math

import numpy as np

from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from ...sanitise import within
from ..driver import Array, CompiledFilter, Records
from ..eskf import tilt_core, turned
from ..inline_math import atan2_core, exp_core, multiply, put, roll_pitch_core, rotate
from ..samples import run_vehicles
from .drag_aided import (
    CLIMB,
    ERRORS,
    OFFSET,
    PARTS,
    REST,
    SCRATCH,
    SHARED,
    at_rest,
    diverged,
    mean_square,
)
from .imm_model import (
    COUNT,
    MODELS,
    MULTIROTOR,
    STATE,
    Integrated,
    across_thrust,
    combine,
    correct_model,
    mix,
    predict_model,
)

RECORD = np.dtype(
    [
        ("models", STATE, (COUNT,)),
        ("probability", "f8", COUNT),
        ("quat", "f8", 4),  # combined
        ("velocity", "f8", 3),
        ("gyro_bias", "f8", 3),
        ("accel_bias", "f8", 3),
        ("covariance", "f8", (SHARED, SHARED)),
        ("accel_square", "f8"),  # as of the models
        ("body_square", "f8"),  # mean square of the force across body z, per axis [m²/s⁴]
        *REST,
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
        ("evidence", "f8", COUNT),  # logarithm of each model's likelihood
        *SCRATCH,
    ]
)
"""State of the filter: models, their combination, and readings since their last update."""

ESTIMATED = [*range(CLIMB), *range(OFFSET, ERRORS)]
"""Errors in the model of a multirotor."""
MODEL_HZ = 50.0
"""Rate of the updates of the models [1/s]; at lower sample rates, every sample is an update."""


@njit
def take_vibration(s, p, dt, change):
    """Update the mean square of the vibration by a change of the specific force [m/s²].

    A second difference has six times the variance of white noise, and almost no contribution of motion.
    """
    square = 0.0
    for k in range(3):
        square += (change[k] - s.change[k]) ** 2 / 18.0
        s.change[k] = change[k]
    s.shake += (square - s.shake) * min(dt / p.vibration_memory, 1.0)


@njit
def accumulate(s, p, sample):
    """Add a `Sample` to the sums since the last update of the models."""
    dt, gyro, accel, last = sample.dt, sample.gyro, sample.accel, s.force
    turn = exp_core(gyro[0] * dt, gyro[1] * dt, gyro[2] * dt)
    put(s.turn, multiply(s.turn, turn))
    known = last[0] != 0.0 or last[1] != 0.0 or last[2] != 0.0
    change = (accel[0] - last[0], accel[1] - last[1], accel[2] - last[2])
    blow = known and not within(change[0], change[1], change[2], p.jerk_max * dt)
    found = sample.found and not blow
    before = 0.5 * dt if found and known else 0.0  # trapezoidal rule
    after = dt - before if found else 0.0
    if found and known:
        take_vibration(s, p, dt, change)
    push = (s.push[0] + before * last[0], s.push[1] + before * last[1], s.push[2] + before * last[2])
    push = rotate((turn[0], -turn[1], -turn[2], -turn[3]), push)
    share = dt / (dt + p.rate_memory)
    for k in range(3):
        s.push[k] = push[k] + after * accel[k]
        s.force_sum[k] += dt * accel[k] if found else 0.0
        s.force[k] = accel[k] if found else 0.0
        s.last_rate[k] += share * (gyro[k] - s.last_rate[k])
    s.force_time += dt if found else 0.0
    s.interval += dt
    s.time += dt
    s.unseen += sample.unseen
    if sample.rotor_square > 0.0:
        s.rotor_time += dt
        s.rotor_sum += dt * sample.rotor_square


@njit
def scaled(scale, v):
    """Return a vector times a number, a tuple."""
    return scale * v[0], scale * v[1], scale * v[2]


@njit
def rotation_vector(turn):
    """Return the rotation vector of a quaternion with an angle of less than π [rad]."""
    length = math.sqrt(turn[1] ** 2 + turn[2] ** 2 + turn[3] ** 2)
    scale = 2.0 if length < 1e-9 else 2.0 * atan2_core(length, turn[0]) / length
    return scaled(scale, turn[1:])


@njit
def weigh(s, change):
    """Update the probabilities by a measurement; `evidence` (m,) is the logarithm of its likelihood."""
    evidence = s.evidence
    highest, total = max(evidence), 0.0
    for k in range(COUNT):
        prior = s.probability[k] + change * (1.0 - s.probability[k])
        evidence[k] = prior * math.exp(max(evidence[k] - highest, -300.0))
        total += evidence[k]
    for k in range(COUNT):
        s.probability[k] = evidence[k] / total


@njit
def integrated_interval(s, p):
    """Return the finished `Integrated`; the first one with a specific force starts the models."""
    dt, turn = s.interval, rotation_vector(s.turn)
    rate = (turn[0] / dt, turn[1] / dt, turn[2] / dt)
    found = s.force_time > 0.5 * dt
    scale = 1.0 / s.force_time if found else 0.0
    accel, body = scaled(scale, s.push), scaled(scale, s.force_sum)
    arm = ((s.last_rate[1] - s.rate_before[1]) / dt, (s.rate_before[0] - s.last_rate[0]) / dt)
    if s.time < 1.5 * dt:  # no rate before the first
        arm = (0.0, 0.0)
    s.rate_before[:] = s.last_rate
    if s.begun == 0.0 and found:
        begin_at(s, accel)
    thrust = thrust_of_rotors(s, p, dt, body[2]) if found and s.rotor_time > 0.5 * dt else body[2]
    resting = found and at_rest(s, p, dt, rate, body)
    return Integrated(dt, turn, rate, s.unseen, found, accel, body, thrust, arm, resting)


@njit
def update_models(s, p):
    """Update all models by the finished interval, and combine them."""
    x = integrated_interval(s, p)
    if x.found:
        across, along = across_thrust(s.models[MULTIROTOR], x)
        square = 0.5 * (across * across + along * along)
        s.body_square = mean_square(s.body_square, square, x.dt, s.time, p.square_memory)
    for k in range(COUNT):
        matrix = predict_model(s.models[k], k, s, p, x)
        s.evidence[k] = correct_model(s.models[k], k, s, p, x, matrix) if x.found else 0.0
    change = x.dt / (COUNT * p.sojourn_time)
    weigh(s, change)
    combine(s)
    mix(s, p, change)
    s.interval = s.force_time = s.unseen = s.rotor_time = s.rotor_sum = 0.0
    s.turn[0], s.turn[1:], s.push[:], s.force_sum[:] = 1.0, 0.0, 0.0, 0.0


@njit
def thrust_of_rotors(s, p, dt, along):
    """Return thrust per mass κ Σ ω² [m/s²], with κ by least squares from the force `along` body z."""
    square = s.rotor_sum / s.rotor_time
    s.rotor_product = mean_square(s.rotor_product, square * along, dt, s.time, p.square_memory)
    s.rotor_square = mean_square(s.rotor_square, square * square, dt, s.time, p.square_memory)
    return square * s.rotor_product / s.rotor_square


@njit
def begin_at(s, accel):
    """Start all models at the tilt at which the first force is vertical."""
    x, y = tilt_core(accel)
    for k in range(COUNT):
        put(s.models[k].quat, turned(s.models[k].quat, x, y))
    s.begun = 1.0


@njit
def inverted(s, p):
    """Return whether the vertical velocity shows that the estimate is upside down, as after a gap.

    With the memory τ = `climb_time`, the vertical velocity tends to −g τ in free fall, and to −2 g τ if the
    estimate is upside down.
    """
    return s.velocity[2] < -GRAVITY * p.climb_time


@njit
def step(s, p, sample):
    """Process a sample as described in `driver`.

    Between updates of the models, only the combined attitude is rotated.
    """
    accumulate(s, p, sample)
    dt, gyro, b = sample.dt, sample.gyro, s.gyro_bias
    if s.interval < 1.0 / MODEL_HZ - 0.5 * dt:
        turn = exp_core((gyro[0] - b[0]) * dt, (gyro[1] - b[1]) * dt, (gyro[2] - b[2]) * dt)
        put(s.quat, multiply(s.quat, turn))
    else:
        update_models(s, p)
        if diverged(s.gyro_bias, s.velocity) or inverted(s, p):
            return math.nan, math.nan
    return roll_pitch_core(s.quat)


@njit(cache=True, nogil=True)
def run(states, samples, params, dt, gyro, accel, rotor_vel, out):
    """Process a sample or sequences; see `driver`."""
    run_vehicles(step, states, samples, params, dt, gyro, accel, rotor_vel, out)


class InteractingModels(CompiledFilter):
    """The filter for n vehicles, with model probabilities; σ is that of the last update of the models."""

    record, run = RECORD, staticmethod(run)
    models = MODELS
    """Names of the models, in the order of `model_probability`."""

    def begin(self, states: Records, quat: Array, known: bool) -> None:
        """Start at a known attitude, or at level until the first force.

        A given start has the same tilt variance, because a wrong start would otherwise be estimated as a
        bias.
        """
        models = states["models"]
        sigma = np.array([self.values[f"{part}_sigma"] for part in PARTS[ESTIMATED]])
        models["quat"], states["quat"] = quat[:, None], quat
        models["wind_noise"], models["usual_ratio"] = (
            self.values["wind_noise"] ** 2,
            self.values["usual_first"],
        )
        models["covariance"][:, :, ESTIMATED, ESTIMATED] = sigma**2
        states["covariance"] = models["covariance"][:, 0, :SHARED, :SHARED]
        states["begun"], states["probability"] = float(known), 1.0 / COUNT
        states["turn"][:, 0] = 1.0

    def tilt_covariance(self) -> Array:
        """Covariance of the models plus the variance of the mean force, which vibration shifts."""
        shifted = (self.values["rectified_share"] / GRAVITY) ** 2 * self.state["shake"]
        return super().tilt_covariance() + shifted[:, None, None] * np.eye(2)

    @property
    def model_probability(self) -> Array:
        """Probability of each model, (n, 3); each row sums to 1."""
        return self.state["probability"].copy()
