"""Margins of an attitude controller: how much its answer may be scaled or delayed before a vehicle falls."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadsim.control.cascade import Controller, follow_attitude
from quadsim.control.own import AttitudeController, MakeController
from quadsim.control.records import MEASURED, SET_POINT
from quadsim.estimator import AttitudeEstimator
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import Scenario
from quadsim.runs.compiled import njit
from quadsim.seeding import vehicle_seeds
from quadsim.vehicle import Vehicle

Array = NDArray[np.float64]
ATTITUDE_LEVEL = 2
"""Of the cascade: nothing is fed forward."""
GAINS = tuple(float(x) for x in 1.15 ** np.arange(1, 21))
"""Tried one after the other, up to 16 times."""
DELAYS = tuple(range(1, 41))
"""The same [samples]."""


@dataclass(frozen=True)
class Margins:
    """Where the first of the flights crashes; None: nowhere."""

    gain_up: float | None
    """More angular acceleration than the controller asks for."""
    gain_down: float | None
    """Less."""
    delay_s: float | None
    """Later [s]."""


class Cascade:
    """The cascade's levels of attitude and body rate as an `AttitudeController`."""

    def __init__(self, rate_hz: float, vehicle: Vehicle) -> None:
        self._made = rate_hz, vehicle

    def reset(self, n: int) -> None:
        """Start n vehicles."""
        rate_hz, vehicle = self._made
        self.records = Controller(vehicle, n, rate_hz).records
        self.measured, self.targets = np.zeros(n, MEASURED), np.zeros(n, SET_POINT)

    def restart(self, ids: NDArray[np.int64]) -> None:
        """Start some of them anew."""
        rate_hz, vehicle = self._made
        self.records[ids] = Controller(vehicle, len(ids), rate_hz).records

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array) -> Array:
        """See `AttitudeController`."""
        self.measured["gyro"], self.measured["roll_pitch"] = gyro, roll_pitch
        _follow_all(self.targets, self.measured, set_point, self.records)
        return np.concatenate([self.records["ang_acc_cmd"], set_point[:, 3:]], axis=1)


class Altered:
    """A controller whose angular acceleration arrives scaled and late."""

    def __init__(self, controller: AttitudeController, gain: float = 1.0, delay: int = 0) -> None:
        self.controller, self.gain, self.delay = controller, gain, delay

    def reset(self, n: int) -> None:
        """Start n vehicles."""
        self.controller.reset(n)
        self._late = np.zeros((self.delay + 1, n, 3))

    def restart(self, ids: NDArray[np.int64]) -> None:
        """Start some of them anew."""
        self.controller.restart(ids)  # pyright: ignore[reportAttributeAccessIssue]
        self._late[:, ids] = 0.0

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array) -> Array:
        """See `AttitudeController`."""
        action = self.controller.update(set_point, gyro, accel, roll_pitch)
        self._late = np.roll(self._late, 1, axis=0)
        self._late[0] = self.gain * action[:, :3]
        return np.concatenate([self._late[-1], action[:, 3:]], axis=1)


def margins(
    make: MakeController,
    scenario: Scenario,
    estimator: AttitudeEstimator | None,
    seeds: int = 8,
    rate_hz: float = 200.0,
) -> Margins:
    """Fly a scenario with ever more gain, less gain and delay, until a flight crashes.

    Args:
        make: Makes the controller; `Cascade` for the cascade's.
        scenario: What to fly.
        estimator: Source of roll and pitch; None for the truth.
        seeds: Flights at each value.
        rate_hz: Samples per second.
    """

    def crashes(gain: float = 1.0, delay: int = 0) -> bool:
        def made(rate_hz: float, vehicle: Vehicle) -> Altered:
            return Altered(make(rate_hz, vehicle), gain, delay)

        mission = Mission(scenario, estimator, seeds, rate_hz, controller=made)
        mission.begin(vehicle_seeds(0, seeds))
        while mission.k.min() < mission.steps and not mission.cause.any():
            mission.step()
        return bool(mission.cause.any())

    def first(values: Iterable[tuple[float, int]]) -> tuple[float, int] | None:
        return next((value for value in values if crashes(*value)), None)

    up = first((gain, 0) for gain in GAINS)
    down = first((1.0 / gain, 0) for gain in GAINS)
    late = first((1.0, delay) for delay in DELAYS)
    return Margins(up and up[0], down and down[0], late and late[1] / rate_hz)


@njit(cache=True)
def _follow_all(targets, measured, set_points, records):
    for i in range(records.shape[0]):
        follow_attitude(ATTITUDE_LEVEL, targets[i], measured[i], set_points[i], records[i])
