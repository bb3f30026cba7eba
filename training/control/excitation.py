"""What is added to the flights that controllers learn from: set-points, torques, uneven rotors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Excitation:
    """What is added to flights of the recipe, drawn for each flight and, in turn, for each part of it.

    All but the thrust of rotors and battery is scaled by a factor of the flight, the square of a uniform
    number: half of the flights are calm.
    """

    step_deg: float = 20.0
    """Largest step of the roll and the pitch set-point [deg]."""
    step_s: tuple[float, float] = (0.2, 0.8)
    """Its shortest and longest duration [s]."""
    chirp_deg: float = 10.0
    """Largest amplitude of a chirp of them [deg]."""
    chirp_hz: tuple[float, float] = (0.3, 4.0)
    """Range of its frequencies [Hz]."""
    yaw_rate: float = 1.0
    """Largest step of the yaw-rate set-point [rad/s]."""
    still: float = 0.6
    """Share of the parts of a flight without any of these."""
    pulse: float = 15.0
    """Largest pulse of angular acceleration about roll and pitch, a tenth of it about yaw [rad/s²]."""
    noise: float = 3.0
    """Standard deviation of a slowly varying disturbance of the command, about yaw a tenth of it [rad/s²]."""
    rotor_spread: float = 0.06
    """Largest loss of thrust of a rotor, as a share: a constant torque, as of a displaced centre of mass."""
    battery: float = 0.8
    """Least thrust of all rotors over the nominal one."""
    start_tilt_deg: float = 30.0
    """Largest tilt at the start, which no estimate knows [deg]."""


STANDARD = Excitation()
"""Of the flights that the shipped controllers learnt from."""


class SetPointExcitation(NamedTuple):
    """What is added to a flight's set-points of roll, pitch [rad] and yaw rate [rad/s]."""

    jumps: Array
    """Steps, (T, 3)."""
    chirps: Array
    """Sines of rising or falling frequency that swell and fade, (T, 3)."""


def set_point_excitation(
    added: Excitation, steps: int, rate_hz: float, rng: np.random.Generator
) -> SetPointExcitation:
    """Steps and chirps of roll and pitch, steps of the yaw rate, for a flight of some samples."""
    out, k = SetPointExcitation(np.zeros((steps, 3)), np.zeros((steps, 3))), 0
    (low, high), tilt = added.step_s, math.radians(added.step_deg)
    while k < steps:
        kind = rng.random()
        length = max(1, round(rate_hz * math.exp(rng.uniform(math.log(low), math.log(high)))))
        part = slice(k, min(k + length, steps))
        if kind > added.still + 0.6 * (1.0 - added.still):
            length *= 3
            part = slice(k, min(k + length, steps))
            time = np.arange(part.stop - part.start) / rate_hz
            low_hz, high_hz = map(math.log, added.chirp_hz)
            f0, f1 = np.exp(rng.uniform(low_hz, high_hz, 2))
            phase = 2.0 * math.pi * (f0 * time + 0.5 * (f1 - f0) * time**2 * rate_hz / length)
            wave = np.sin(phase) * np.sin(math.pi * rate_hz / length * time)
            out.chirps[part, :2] = wave[:, None] * rng.uniform(-1.0, 1.0, 2) * math.radians(added.chirp_deg)
        elif kind > added.still:
            out.jumps[part] = rng.uniform(-1.0, 1.0, 3) * [tilt, tilt, added.yaw_rate]
        k += length
    return out


def torque_excitation(added: Excitation, steps: int, rate_hz: float, rng: np.random.Generator) -> Array:
    """Pulses and slowly varying noise of angular acceleration, (steps, 3) [rad/s²]."""
    from scipy.signal import lfilter  # takes half a second

    decay = math.exp(-1.0 / (rate_hz * math.exp(rng.uniform(math.log(0.03), math.log(0.3)))))
    white = rng.normal(size=(steps, 3)) * math.sqrt(1.0 - decay**2)
    out = added.noise * rng.uniform() * np.asarray(lfilter([1.0], [1.0, -decay], white, axis=0))
    k = 0
    while k < steps:
        k += round(rate_hz * rng.uniform(0.5, 4.0))
        length = round(rate_hz * rng.uniform(0.02, 0.15))
        out[k : k + length] += added.pulse * rng.uniform(-1.0, 1.0, 3)
        k += length
    return out * [1.0, 1.0, 0.1]


def rotor_effect(added: Excitation, rotors: int, rng: np.random.Generator) -> Array:
    """Thrust of each rotor over its nominal one, (rotors,)."""
    return rng.uniform(added.battery, 1.0) * (1.0 - added.rotor_spread * rng.uniform(0.0, 1.0, rotors))
