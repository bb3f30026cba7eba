"""Excitation of the training flights of controllers, added to set-points and angular accelerations."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadsim.vehicle import GRAVITY

Array = NDArray[np.float64]
RATE_HZ = 200.0
STEP_S, CHIRP_HZ = (0.2, 0.8), (0.3, 4.0)
"""Range of the duration of a step, where a chirp takes three steps [s]; range of the frequencies of a chirp
[Hz]."""


class Excitation(NamedTuple):
    """Largest values of the excitation.

    Each flight has a random share of each, the square of a uniform number.
    """

    step_deg: float = 20.0  #: step of the roll and the pitch set-point [deg]
    chirp_deg: float = 10.0  #: amplitude of a chirp of them [deg]
    yaw_rate: float = 1.0  #: step of the yaw-rate set-point [rad/s]
    pulse: float = 15.0  #: pulse of angular acceleration about roll and pitch; about yaw a tenth [rad/s²]
    noise: float = 3.0  #: standard deviation of its slowly varying noise [rad/s²]
    constant: float = 2.5  #: its constant part, in full: uneven rotors, a displaced centre of mass [rad/s²]


STANDARD = Excitation()


def excite_set_points(
    target: NDArray[np.void], added: Excitation, size: float, velocity_gain: float, rng: np.random.Generator
) -> None:
    """Add a share of steps and chirps to the set-points of a flight, (T,) records of `SET_POINT`.

    A step of the velocity commands a tilt immediately. The tilt of an acceleration is also fed forward as a
    motion.
    """
    step, chirp = (size * GRAVITY * math.radians(tilt) for tilt in (added.step_deg, added.chirp_deg))
    k = 0
    while k < len(target):
        kind = rng.choice(["still", "step", "chirp"], p=[0.6, 0.24, 0.16])
        length = round(RATE_HZ * _log_uniform(STEP_S, rng)) * (3 if kind == "chirp" else 1)
        part = target[k : k + length]
        if kind == "chirp":
            time, share = np.arange(len(part)) / RATE_HZ, np.arange(len(part)) / length
            first, last = _log_uniform(CHIRP_HZ, rng), _log_uniform(CHIRP_HZ, rng)
            wave = np.sin(2.0 * math.pi * time * (first + 0.5 * (last - first) * share))
            wave *= np.sin(math.pi * share)
            part["acceleration"][:, :2] += wave[:, None] * rng.uniform(-chirp, chirp, 2)
        elif kind == "step":
            part["velocity"][:, :2] += rng.uniform(-step, step, 2) / velocity_gain
            part["yaw_rate"] += size * added.yaw_rate * rng.uniform(-1.0, 1.0)
        k += length


def disturbance(added: Excitation, size: float, steps: int, rng: np.random.Generator) -> Array:
    """Draw the disturbance of the angular acceleration over a flight, (steps, 3) [rad/s²]."""
    from scipy.signal import lfilter  # takes half a second

    decay = math.exp(-1.0 / (RATE_HZ * _log_uniform((0.03, 0.3), rng)))
    white = rng.normal(size=(steps, 3)) * math.sqrt(1.0 - decay**2)
    out = size * added.noise * rng.uniform() * np.asarray(lfilter([1.0], [1.0, -decay], white, axis=0))
    k = 0
    while k < steps:
        k += round(RATE_HZ * rng.uniform(0.5, 4.0))
        length = round(RATE_HZ * rng.uniform(0.02, 0.15))
        out[k : k + length] += size * added.pulse * rng.uniform(-1.0, 1.0, 3)
        k += length
    return (out + added.constant * rng.uniform(-1.0, 1.0, 3)) * [1.0, 1.0, 0.1]


def _log_uniform(limits: tuple[float, float], rng: np.random.Generator) -> float:
    low, high = map(math.log, limits)
    return math.exp(rng.uniform(low, high))
