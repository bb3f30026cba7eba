"""The start of a flight on the ground, as the IMU measures it: rest, spin-up of the rotors, and lift-off.

The motion is prescribed, without contact forces: the vehicle stands on a slope, and during lift-off its
attitude and velocity change smoothly into those of the flight.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..rotation import euler_from_quat, quat_from_euler, quat_rotate_inverse
from ..vehicle import GRAVITY
from .hand_held import body_rate

Array = NDArray[np.float64]
STAND_S, SPIN_UP_S, LIFT_OFF_S = (1.0, 5.0), (0.5, 3.0), (0.5, 1.5)
"""Ranges of the time at rest with stopped rotors, of the spin-up time of the rotors, and of the time from
lift-off to the motion of the flight [s]. The times are drawn for each flight."""
SLOPE_DEG = 4.0
"""Largest slope of the ground [deg]."""


def start_on_ground(
    log: NDArray[np.void], rate_hz: float, seeds: Sequence[np.random.SeedSequence]
) -> NDArray[np.int64]:
    """Prepend a start on the ground to each flight, and drop the same number of samples from its end.

    Args:
        log: Flights, (n, T) records of `quadsim.motion.rotors.state_dtype`; changed.
        rate_hz: Samples per second.
        seeds: One per flight.

    Returns:
        Number of samples of the start, (n,).
    """
    before = np.zeros(len(log), np.int64)
    for i, (flight, seed) in enumerate(zip(log, seeds, strict=True)):
        rows = _start(flight[0], rate_hz, np.random.default_rng(seed))[: len(flight)]
        before[i] = len(rows)
        flight[len(rows) :] = flight[: len(flight) - len(rows)].copy()
        flight[: len(rows)] = rows
    return before


def _start(first: np.void, rate_hz: float, rng: np.random.Generator) -> NDArray[np.void]:
    """Return the samples before the first one of a flight."""
    stand, spin_up, lift_off = (rng.uniform(*span) for span in (STAND_S, SPIN_UP_S, LIFT_OFF_S))
    slope, towards = np.radians(SLOPE_DEG) * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi)
    t = np.arange(round((stand + spin_up + lift_off) * rate_hz)) / rate_hz
    share, rise = _smooth((t - stand - spin_up) / lift_off)
    share, rise = share[:, None], rise[:, None] / lift_off
    flying = euler_from_quat(first["quat"])
    turn = flying - np.array([slope * np.cos(towards), slope * np.sin(towards), flying[2]])
    rows = np.zeros(t.size, first.dtype)
    angles = flying - (1.0 - share) * turn
    rows["quat"] = quat_from_euler(*angles.T)
    rows["ang_vel"] = body_rate(angles, rise * turn)
    rows["ang_acc"] = np.gradient(rows["ang_vel"], 1.0 / rate_hz, axis=0)
    rows["velocity"] = share * first["velocity"]
    later = np.append(rows["velocity"][1:], first["velocity"][None], axis=0)
    travelled = 0.5 * (rows["velocity"] + later) / rate_hz  # from each sample to the next
    rows["position"] = first["position"] - travelled[::-1].cumsum(0)[::-1]
    force = rise * first["velocity"] + np.array([0.0, 0.0, GRAVITY])
    rows["specific_force"] = quat_rotate_inverse(rows["quat"], force)
    spinning = np.clip((t - stand) / spin_up, 0.0, 1.0)[:, None]
    rows["rotor_vel"] = rows["rotor_vel_cmd"] = spinning * first["rotor_vel"]
    rows["wind"] = first["wind"]
    return rows


def _smooth(x: Array) -> tuple[Array, Array]:
    """Return 10 x³ − 15 x⁴ + 6 x⁵, which rises from 0 at x = 0 to 1 at x = 1, and its derivative."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * x**2 * (1.0 - x) ** 2
