"""Domain randomisation: vehicle, IMU, wind strength and delay of one flight."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..imu.spec import ImuSpec, randomise_imu
from ..vehicle import Randomisation, Vehicle, randomise


class Domain(NamedTuple):
    """Randomised quantities of one flight."""

    vehicle: Vehicle
    imu: ImuSpec
    wind: float = 1.0
    """Factor of the wind velocity."""
    delay: float = 1.0
    """Factor of the external sensor's delay."""


def domains(
    vehicle: Vehicle, imu: ImuSpec, ranges: Randomisation, seeds: Sequence[np.random.SeedSequence]
) -> list[Domain]:
    """Draw the domain of one flight per seed, around a vehicle and an IMU.

    Without ranges, nothing changes.
    """
    if ranges == Randomisation():
        return [Domain(vehicle, imu)] * len(seeds)
    return [_domain(vehicle, imu, ranges, np.random.default_rng(seed)) for seed in seeds]


def _domain(vehicle: Vehicle, imu: ImuSpec, ranges: Randomisation, rng: np.random.Generator) -> Domain:
    drawn = randomise(vehicle, ranges, rng)
    wind, delay = 1.0 + np.array([ranges.wind, ranges.delay]) * rng.uniform(-1.0, 1.0, 2)
    return Domain(drawn, randomise_imu(imu, ranges.imu, rng) if ranges.imu else imu, wind, delay)
