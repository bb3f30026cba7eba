"""Motion of a hand-held IMU, in closed form: rotations to any attitude, translations, and rests between them.

Roll, pitch, yaw and position are sums of sines of a clock that runs while the hand moves and stops while the
hand rests. Rates and accelerations are therefore exact derivatives. The position has the spectrum of white
noise after three equal first-order lags (Matérn 5/2), so that it stays within the reach of an arm.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ..config.ranges import Between, Rising
from ..config.toml import Strict
from ..rotation import quat_from_euler, quat_rotate_inverse
from ..vehicle import GRAVITY

Array = NDArray[np.float64]
Seeds = Sequence[np.random.SeedSequence]

Turn = Annotated[float, Between(0.1, 2000.0, "°/s")]
Push = Annotated[float, Between(1e-3, 100.0, "m/s²")]
Stretch = Annotated[float, Between(0.1, 1000.0, "s")]

TURN_HZ, TURN_SINES = (0.05, 1.5), 12
"""Frequency band [Hz] and number of the sines of each angle. Each sine has the same rate, and the frequencies
are drawn log-uniformly."""
SHIFT_HZ, SHIFT_SINES = (0.1, 12.0), 36
"""Frequency band [Hz] of the position, up to the fastest tremor of a hand, and number of sines, one in each
equal part of log f."""
PACE_HZ = (1.2, 2.5)
"""Range of the corner frequency of the position [Hz]. At 1.6 Hz, an RMS acceleration of 5 m/s² is an RMS
position of 5 cm."""
SWELL_S = (4.0, 20.0)
"""Range of the period in which the amplitude rises to e times and falls to 1/e of its middle value [s]."""
RAMP_S = 0.5
"""Duration of the beginning and of the end of a motion [s]."""
UP = np.array([0.0, 0.0, 1.0])
"""Direction of the world's z axis."""


class HandHeld(Strict):
    """An IMU that is moved by hand. The RMS rate and acceleration of each flight are drawn log-uniformly."""

    rate_deg_s: Annotated[tuple[Turn, Turn], Rising] = (20.0, 200.0)
    """Range of the RMS body rate, per axis [deg/s]."""
    acceleration: Annotated[tuple[Push, Push], Rising] = (0.3, 6.0)
    """Range of the RMS acceleration, per axis [m/s²]."""
    move_s: Annotated[tuple[Stretch, Stretch], Rising] = (5.0, 30.0)
    """Range of the duration of a motion [s]."""
    rest_s: Annotated[tuple[Stretch, Stretch], Rising] = (1.0, 8.0)
    """Range of the duration of a rest [s]."""


def move_by_hand(spec: HandHeld, steps: int, rate_hz: float, seeds: Seeds) -> dict[str, Array]:
    """Compute the true motion of one IMU per seed.

    Args:
        spec: Parameters of the motion.
        steps: Samples.
        rate_hz: Samples per second.
        seeds: One per flight.

    Returns:
        position, velocity (world), quat, ang_vel, specific_force (body) and ang_acc, each (n, T, ·), as in
        `quadsim.plant.State`.
    """
    flights = [_flight(spec, steps, rate_hz, np.random.default_rng(seed)) for seed in seeds]
    return {name: np.stack([flight[name] for flight in flights]) for name in flights[0]}


def _flight(spec: HandHeld, steps: int, rate_hz: float, rng: np.random.Generator) -> dict[str, Array]:
    rate = np.radians(np.exp(rng.uniform(*np.log(spec.rate_deg_s))))
    push = np.exp(rng.uniform(*np.log(spec.acceleration)))
    clock, speed, change = _clock(spec, np.arange(steps) / rate_hz, rng)
    low, high = np.log(TURN_HZ)
    frequency = 2.0 * np.pi * np.exp(rng.uniform(low, high, (3, TURN_SINES)))
    angles, turning, _ = _sines(clock, frequency, rate * np.sqrt(2.0 / TURN_SINES) / frequency, rng)
    position, moving, pushing = _shifts(clock, push, rng)
    angles[:, 2] += rng.uniform(-np.pi, np.pi)
    velocity = moving * speed[:, None]
    acceleration = pushing * speed[:, None] ** 2 + moving * change[:, None]
    quat = quat_from_euler(*angles.T)
    ang_vel = body_rate(angles, turning * speed[:, None])
    return {
        "position": position,
        "velocity": velocity,
        "quat": quat,
        "ang_vel": ang_vel,
        "specific_force": quat_rotate_inverse(quat, acceleration + UP * GRAVITY),
        "ang_acc": np.gradient(ang_vel, 1.0 / rate_hz, axis=0),
    }


def body_rate(angles: Array, derivative: Array) -> Array:
    """Return the body rate (T, 3) [rad/s] from roll, pitch, yaw (T, 3) [rad] and their derivatives."""
    (roll, pitch, _), (d_roll, d_pitch, d_yaw) = angles.T, derivative.T
    return np.stack(
        [
            d_roll - d_yaw * np.sin(pitch),
            d_pitch * np.cos(roll) + d_yaw * np.cos(pitch) * np.sin(roll),
            d_yaw * np.cos(pitch) * np.cos(roll) - d_pitch * np.sin(roll),
        ],
        axis=-1,
    )


def _clock(spec: HandHeld, time: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return the clock (T,) [s] and its first and second derivative.

    The start within a cycle of moving and resting is random.
    """
    from scipy.interpolate import PchipInterpolator  # scipy.interpolate takes a tenth of a second

    knots, values = [-float(rng.uniform(0.0, spec.move_s[0] + spec.rest_s[0]))], [1.0]
    while knots[-1] < time[-1] + RAMP_S:
        for length, value in ((rng.uniform(*spec.move_s), 1.0), (rng.uniform(*spec.rest_s), 0.0)):
            knots += [knots[-1] + RAMP_S, knots[-1] + RAMP_S + float(length)]
            values += [value, value]
    speed = PchipInterpolator(knots, values)
    return speed.antiderivative()(time), speed(time), speed(time, 1)


def _shifts(clock: Array, push: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return the position (T, 3) and its first two derivatives, for an RMS of the second derivative.

    S_a(ω) ∝ ω⁴ / (ω² + λ²)³ times a swell e^(sin Ωt), whose mean square is I₀(2).
    """
    low, high = np.log(SHIFT_HZ)
    part = (np.arange(SHIFT_SINES) + rng.uniform(size=(3, SHIFT_SINES))) / SHIFT_SINES
    frequency = 2.0 * np.pi * np.exp(low + (high - low) * part)
    pace = 2.0 * np.pi * np.exp(rng.uniform(*np.log(PACE_HZ)))
    power = frequency**5 / (frequency**2 + pace**2) ** 3  # of a sine for an equal part of log ω
    power *= push**2 / (np.i0(2.0) * power.sum(axis=1, keepdims=True))
    position, moving, pushing = _sines(clock, frequency, np.sqrt(2.0 * power) / frequency**2, rng)
    swell = 2.0 * np.pi / rng.uniform(*SWELL_S)
    phase = (swell * clock + rng.uniform(0.0, 2.0 * np.pi))[:, None]
    size, growth = np.exp(np.sin(phase)), swell * np.cos(phase)
    bend = growth**2 - swell**2 * np.sin(phase)
    return (
        size * position,
        size * (moving + growth * position),
        size * (pushing + 2.0 * growth * moving + bend * position),
    )


def _sines(
    clock: Array, frequency: Array, amplitude: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return three sums (T, 3) of sines (3, k) and their first two derivatives."""
    angle = frequency * clock[:, None, None] + rng.uniform(0.0, 2.0 * np.pi, frequency.shape)
    sine, cosine = np.sin(angle), np.cos(angle)
    return (
        (amplitude * sine).sum(axis=-1),
        (amplitude * frequency * cosine).sum(axis=-1),
        (-amplitude * frequency**2 * sine).sum(axis=-1),
    )
