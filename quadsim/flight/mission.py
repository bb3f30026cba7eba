"""A mission: n flights of one scenario with one estimator, one sample at a time, with detection of crashes.

The closed-loop benchmark and the Gymnasium environments both fly missions. A flight depends only on the
scenario, the estimator and its own seed.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..config.ranges import steps_of
from ..control.attitude_controller import MakeController
from ..control.records import Command, Level
from ..estimator import AttitudeEstimator
from ..external import ExternalSensor, ExternalSpec, load_external
from ..imu.spec import load_imu
from ..rotation import quat_from_euler, quat_from_rotvec, quat_multiply
from ..seeding import AIR, BEGINNING, BODY, EXTERNAL, FAULT, SENSOR, TRAJECTORY, children
from ..trajectory.reference import reference
from ..trajectory.specs import Trajectory
from ..vehicle import Randomisation, load_vehicle, with_drag
from ..wind import WindSpec, wind_series
from .domain import Domain, domains
from .faults import displaced, sensor_faults
from .loop import FlightLoop
from .scenario import Scenario
from .vehicle_faults import VehicleFaults
from .world import FLYING, PLAN

Array = NDArray[np.float64]
Seeds = Sequence[np.random.SeedSequence]


class Mission(FlightLoop):
    """The loops of n flights of a scenario. Call `begin`, then `step` until `k` reaches `steps`.

    `k` (n,) counts the samples of each flight. `target` (n,), records of `SET_POINT`, and `air` (n, 3) are
    set-point and wind. `cause` (n,) is the cause of a crash; 0 means no crash. The motion of a vehicle after
    a crash has no meaning: the vehicle is moved back above its set-point whenever it crashes again.

    Args:
        scenario: The scenario.
        estimator: Source of roll and pitch; None for the truth.
        n: Number of flights.
        rate_hz: Samples per second.
        duration_s: Length of a flight, instead of the scenario's.
        controller: Function that makes the attitude controller, see `quadsim.control.attitude_controller`;
            None for the cascade.
    """

    def __init__(
        self,
        scenario: Scenario,
        estimator: AttitudeEstimator | None = None,
        n: int = 1,
        rate_hz: float = 200.0,
        duration_s: float | None = None,
        controller: MakeController | None = None,
    ) -> None:
        self.scenario, self.estimator, self.n, self.rate_hz = scenario, estimator, n, rate_hz
        self.vehicle = with_drag(load_vehicle(scenario.vehicle), scenario.drag_factor)
        self.steps = steps_of(scenario.duration_s if duration_s is None else duration_s, rate_hz)
        self._spec = displaced(load_imu(scenario.imu), scenario.faults)
        self._outside, self._make = load_external(scenario.external), controller

    def begin(self, seeds: Seeds) -> None:
        """Begin all flights, with one seed each."""
        if len(seeds) != self.n:
            raise ValueError(f"{len(seeds)} seeds for {self.n} flights; there must be one for each")
        faults, crash, external = self.scenario.faults, self.scenario.crash, None
        drawn = self._drawn(seeds)
        if self._outside != ExternalSpec():
            external = ExternalSensor(
                self._outside,
                self.n,
                self.rate_hz,
                children(seeds, EXTERNAL),
                1.0 + self.scenario.randomisation.delay,
            )
            external.delay(slice(None), [each.delay for each in drawn])
        super().__init__(
            [each.vehicle for each in drawn],
            self.n,
            rate_hz=self.rate_hz,
            imu=[each.imu for each in drawn],
            estimator=self.estimator,
            seed=children(seeds, SENSOR),
            contact=self.scenario.contact,
            nominal=self.vehicle,
            engine=self.scenario.engine,
            external=external,
            controller=self._make,
            corrupt=sensor_faults(faults, self.n, self.rate_hz, children(seeds, FAULT)),
            plans=self._plan(seeds, drawn),
        )
        self._faults, self._flights = VehicleFaults(faults, self.plant), self.records["flight"]
        self._flights["min_cos_tilt"] = math.cos(math.radians(crash.tilt_deg))
        self._flights["min_altitude"], self._flights["max_distance"] = 0.0, crash.distance
        self.reset(**self._start(seeds, self.plans["target"][:, 0]))
        # a start beyond the limits has a sample's time to come back
        self._flights["cause"] = self._flights["crashed"] = self.crashed = FLYING

    def restart(self, ids: NDArray[np.int64], seeds: Seeds) -> None:
        """Restart some flights, with one seed each, while the others continue.

        Call `sense` before reading their state.

        Sensor noise and faults continue the random streams of the seed of the vehicle's first flight.
        """
        drawn = self._drawn(seeds)
        self.plans[ids] = plans = self._plan(seeds, drawn)
        self._flights["cause"][ids] = self._flights["crashed"][ids] = FLYING
        if self.imu is not None and self.scenario.randomisation != Randomisation():
            self.plant.exchange(ids, [each.vehicle for each in drawn])
            self.imu.exchange(ids, [each.imu for each in drawn])
            self.external.delay(ids, [each.delay for each in drawn])
        self._faults.restart(ids, [each.vehicle.mass for each in drawn])
        self.reset(**self._start(seeds, plans["target"][:, 0]), ids=ids)

    def _accept(self, level: Level, command: Command | None, wind: Array | None) -> int:
        """Move crashed vehicles back above their set-points, and apply the faults of vehicles."""
        self.put_back()
        if self._faults.any:
            self._faults.apply(self.k)
        return super()._accept(level, command, wind)

    def _drawn(self, seeds: Seeds) -> list[Domain]:
        spread = self.scenario.randomisation
        return domains(self.vehicle, self._spec, spread, children(seeds, BODY))

    def _plan(self, seeds: Seeds, drawn: Sequence[Domain]) -> NDArray[np.void]:
        """Return set-points and winds of complete flights, (n, steps + 1) records of `PLAN`."""
        path, air = children(seeds, TRAJECTORY), children(seeds, AIR)
        scenario, steps = self.scenario, self.steps + 1
        return planned(scenario.trajectory, scenario.wind, drawn, steps, self.rate_hz, path, air)

    def _start(self, seeds: Seeds, first: NDArray[np.void]) -> dict[str, Any]:
        """Return the arguments of `FlightLoop.reset` for the first set-points (n,)."""
        start = self.scenario.start
        randoms = map(np.random.default_rng, children(seeds, BEGINNING))
        angles = np.array([random.uniform(-np.pi, np.pi, 4) for random in randoms])
        course, tilt_axis, spin_axis, error_axis = np.stack(
            [np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1
        ).swapaxes(0, 1)
        heading = quat_from_euler(0.0, 0.0, first["yaw"])
        error = math.radians(start.attitude_error_deg) * error_axis
        return {
            "position": first["position"] + start.offset,
            "velocity": first["velocity"] + start.speed * course,
            "quat": quat_multiply(heading, quat_from_rotvec(math.radians(start.tilt_deg) * tilt_axis)),
            "ang_vel": math.radians(start.rate_deg) * spin_axis,
            "known_attitude": start.known_attitude,
            "attitude_error": error if start.attitude_error_deg else None,
        }


def planned(
    trajectory: Trajectory,
    wind: Sequence[WindSpec],
    drawn: Sequence[Domain],
    steps: int,
    rate_hz: float,
    path: Seeds,
    air: Seeds,
) -> NDArray[np.void]:
    """Return set-points and winds per domain and pair of seeds, (n, steps) records of `PLAN`."""
    plans = np.zeros((len(path), steps), PLAN)
    plans["target"] = reference(trajectory, steps, rate_hz, path)
    if wind:
        factors = np.array([each.wind for each in drawn])
        plans["wind"] = factors[:, None, None] * wind_series(wind, len(path), steps, rate_hz, air)
    return plans
