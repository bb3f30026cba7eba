"""The mean specific force: along body z in hover, and without a turn at rest."""

from typing import NamedTuple

import numpy as np

from ..dataset.stretches import blocks_of
from ..rotation import matrix_from_quat, quat_from_roll_pitch, roll_pitch_of_up
from ..vehicle import GRAVITY
from .recording import Array

HOVER_RATE, HOVER_RMS = 0.15, 0.3
"""Mean and root mean square of the body rate over a second of hover, at most [rad/s],"""
HOVER_FORCE = 0.1
"""and share by which the mean specific force of that second may differ from gravity."""
LEAST_HOVER_S = 3
"""Fewest seconds of hover that are used alone; with fewer the complete log is used."""
REST_SHARE = 0.03
"""Share of the specific force within which it stays at rest."""


class Level(NamedTuple):
    """Where the specific force points on average."""

    force: Array
    """Mean specific force, in IMU axes (3,) [m/s²]."""
    sd_deg: float
    """Standard deviation of the direction of that mean, by the scatter of its seconds [deg]."""
    seconds: int
    hover: bool
    """Whether these are seconds of hover (or at rest); else they are all of the log's."""

    @property
    def tilt_deg(self) -> float:
        """Angle between the mean force and z [deg]."""
        return float(np.degrees(np.arctan2(np.hypot(*self.force[:2]), self.force[2])))

    @property
    def mount(self) -> Array:
        """The rotation without a change of heading that brings the mean force to body z (3, 3)."""
        roll, pitch = roll_pitch_of_up(self.force)
        steep = np.hypot(*self.force[1:]) < 0.02 * abs(self.force[0])  # x is up or down: any roll is the same
        return matrix_from_quat(quat_from_roll_pitch([0.0 if steep else roll, pitch]))


class Rest(NamedTuple):
    """A stretch at rest."""

    seconds: int
    rate: float
    """The gyroscope's mean rate across the force [rad/s]: its bias."""


def level(gyro: Array, accel: Array, rate_hz: float) -> Level | None:
    """Mean specific force of the seconds of hover, or of all where there are too few.

    Args:
        gyro: (T, 3) [rad/s], NaN where missing.
        accel: Specific force (T, 3) [m/s²], NaN where missing.
        rate_hz: Samples per second.

    Returns:
        The mean; None where no second is without missing samples.
    """
    rates, forces = (blocks_of(each, round(rate_hz)) for each in (gyro, accel))
    complete = np.isfinite(rates).all(axis=(1, 2)) & np.isfinite(forces).all(axis=(1, 2))
    rates, forces = rates[complete], forces[complete].mean(axis=1)
    if not len(forces):
        return None
    hover = np.linalg.norm(rates.mean(axis=1), axis=1) < HOVER_RATE
    hover &= np.sqrt((rates**2).sum(axis=2).mean(axis=1)) < HOVER_RMS
    hover &= np.abs(np.linalg.norm(forces, axis=1) / GRAVITY - 1.0) < HOVER_FORCE
    alone = int(hover.sum()) >= LEAST_HOVER_S
    forces = forces[hover] if alone else forces
    mean = forces.mean(axis=0)
    scatter = forces.std(axis=0) / np.sqrt(len(forces)) / max(float(np.linalg.norm(mean)), 1e-9)
    return Level(mean, float(np.degrees(np.linalg.norm(scatter))), len(forces), alone)


def turn_at_rest(gyro: Array, accel: Array, rate_hz: float) -> Rest | None:
    """The stretch at rest over which the vertical turns most by the gyroscope.

    At rest are seconds in which the specific force is gravity's to a tenth and stays within a share of
    itself, from the first of the stretch on. The turn is that of the mean rate ω across the force: a vehicle
    that turns so is not at rest. In a steady banked turn ω is at the angle of bank from the force, which is
    below 25° where the force is below 1.1 g: an ω within 30° of the force counts as 0.

    Args:
        gyro: (T, 3) [rad/s], NaN where missing.
        accel: Specific force (T, 3), [m/s²], NaN where missing.
        rate_hz: Samples per second.

    Returns:
        The stretch; None where there is none.
    """
    rates, forces = (blocks_of(each, round(rate_hz)) for each in (gyro, accel))
    means, rates = forces.mean(axis=1), rates.mean(axis=1)
    size = np.linalg.norm(means, axis=1)
    steady = np.isfinite(rates).all(axis=1) & (np.linalg.norm(forces.std(axis=1), axis=1) < REST_SHARE * size)
    steady &= np.abs(size / GRAVITY - 1.0) < HOVER_FORCE
    most: Rest | None = None
    start = 0
    for k in range(len(means) + 1):
        ends = k == len(means) or not steady[k]
        if ends or np.linalg.norm(means[k] - means[start]) > REST_SHARE * size[start]:
            if k > start and steady[start]:
                mean = rates[start:k].mean(axis=0)
                across = float(np.linalg.norm(np.cross(means[start] / size[start], mean)))
                rate = across if across > 0.5 * float(np.linalg.norm(mean)) else 0.0
                if most is None or rate * (k - start) > most.rate * most.seconds:
                    most = Rest(k - start, rate)
            start = k + ends
    return most
