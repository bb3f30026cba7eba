"""A mission: n flights of one scenario on one estimator, one sample at a time, and who judges their crashes.

The closed-loop benchmark and the Gymnasium environments both fly missions. A flight depends on the scenario,
the estimator and its own seed, and on nothing else: neither on n, nor on the flights beside it.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..config.ranges import steps_of
from ..control.cascade import WIDTH, Level
from ..estimator import AttitudeEstimator
from ..external import ExternalSensor, ExternalSpec, load_external
from ..imu.spec import load_imu
from ..rotation import quat_from_euler, quat_from_rotvec, quat_multiply
from ..runs.compiled import njit
from ..seeding import child
from ..trajectory.reference import reference
from ..vehicle import load_vehicle
from ..wind import wind_series
from .faults import VehicleFaults, sensor_faults
from .loop import FlightLoop
from .scenario import Scenario

Array = NDArray[np.float64]
Seeds = Sequence[np.random.SeedSequence]

FLYING, TILTED, GROUNDED, AWAY, DIVERGED = range(5)
CAUSES = ("", "tilted over", "hit the ground", "flew away", "diverged")
"""Why a flight ended, by the codes above."""

TRAJECTORY, AIR, SENSOR, BEGINNING, FAULT, EXTERNAL = range(6)
"""Children of a flight's seed, one for each component that draws from it."""


class Mission:
    """n flights of a scenario. `begin` them, then `step` until `k` reaches `steps`.

    `loop` holds plant, sensors, estimate and controller at the current sample; `k` (n,) counts each flight's
    samples; `cause` (n,) tells which flights have crashed, and why. What a crashed vehicle does then means
    nothing: it is put back above its set-point as often as it crashes again, so that no number overflows.

    `sense` is `loop.sense`, then `fallen`, the number of vehicles down, from `follow(*arrays)`; an inner loop
    may do these two itself, with `follow` inside a kernel of its own.

    Args:
        scenario: What to fly.
        estimator: Source of roll and pitch; None for the truth.
        n: Number of flights.
        rate_hz: Samples per second.
        duration_s: Length of a flight, instead of the scenario's.
    """

    def __init__(
        self,
        scenario: Scenario,
        estimator: AttitudeEstimator | None = None,
        n: int = 1,
        rate_hz: float = 200.0,
        duration_s: float | None = None,
    ) -> None:
        self.scenario, self.n, self.rate_hz = scenario, n, rate_hz
        self.vehicle = load_vehicle(scenario.vehicle)
        self.steps = steps_of(scenario.duration_s if duration_s is None else duration_s, rate_hz)
        self._imu, self._estimator = load_imu(scenario.imu), estimator
        self._external = load_external(scenario.external)
        self._limits = np.array(
            [
                math.cos(math.radians(scenario.crash.tilt_deg)),
                scenario.crash.altitude,
                scenario.crash.distance,
            ]
        )
        self.target, self.air = np.zeros((n, WIDTH["position"])), np.zeros((n, 3))
        self.cause = np.zeros(n, dtype=np.int64)
        self._down = np.zeros(n, dtype=np.int64)

    def begin(self, seeds: Seeds) -> None:
        """Begin all flights anew, one seed each."""
        if len(seeds) != self.n:
            raise ValueError(f"{len(seeds)} seeds for {self.n} flights; there must be one for each")
        self._targets, self._winds = self._plan(seeds)
        faults, external = self.scenario.faults, None
        if self._external != ExternalSpec():
            outside = [child(seed, EXTERNAL) for seed in seeds]
            external = ExternalSensor(self._external, self.n, self.rate_hz, outside)
        self.loop = FlightLoop(
            self.vehicle,
            self.n,
            rate_hz=self.rate_hz,
            imu=self._imu,
            estimator=self._estimator,
            seed=[child(seed, SENSOR) for seed in seeds],
            contact=self.scenario.contact,
            external=external,
            corrupt=sensor_faults(faults, self.n, self.rate_hz, [child(seed, FAULT) for seed in seeds]),
        )
        self._faults = VehicleFaults(faults, self.loop.plant)
        self.k = self.loop.k
        self.cause[:] = self._down[:] = FLYING
        self.fallen = 0
        plant = self.loop.plant
        self.arrays = (
            self.k, self._targets, self._winds, self.target, self.air, self._limits,
            plant.position, plant.quat, plant.ang_vel, self._down, self.cause,
        )  # fmt: skip
        start = self._start(seeds, self._targets[:, 0])
        self.loop.reset(*start, known_attitude=self.scenario.start.known_attitude)
        look_up(self.k, self._targets, self._winds, self.target, self.air)

    def restart(self, ids: NDArray[np.int64], seeds: Seeds) -> None:
        """Begin some flights anew, one seed each, while the others go on; call `sense` before they are read.

        Sensor noise and faults go on with what the seed of the vehicle's first flight holds for its next.
        """
        targets, winds = self._plan(seeds)
        self._targets[ids] = targets
        if len(self._winds) == self.n and self.scenario.wind:
            self._winds[ids] = winds
        self.cause[ids] = self._down[ids] = FLYING
        self.loop.restart(
            ids, *self._start(seeds, targets[:, 0]), known_attitude=self.scenario.start.known_attitude
        )

    def step(self, level: Level = "position", command: Array | None = None) -> None:
        """Fly on by one sample, to the scenario's set-point or on a command at a level of the controller."""
        self.move(level, command)
        self.sense()

    def move(self, level: Level = "position", command: Array | None = None) -> None:
        """The first half of `step`: control and motion."""
        if self.fallen:
            fallen = np.flatnonzero(self._down)
            self.loop.plant.reset(position=self.target[fallen, :3] + [0.0, 0.0, 1.0], ids=fallen)
            self.loop.controller.reset(fallen)
        if self._faults.any:
            self._faults.apply(self.k)
        self.loop.move(level, self.target if command is None else command, self.air)

    def sense(self) -> None:
        """The second half of `step`: IMU, estimate, the next set-point, and who has crashed."""
        self.loop.sense()
        self.fallen = follow(*self.arrays)

    def _plan(self, seeds: Seeds) -> tuple[Array, Array]:
        """Set-points (n, steps + 1, 11) and winds (n or 1, steps + 1, 3) of whole flights."""
        steps = self.steps + 1
        path, air = ([child(seed, part) for seed in seeds] for part in (TRAJECTORY, AIR))
        targets = reference(self.scenario.trajectory, steps, self.rate_hz, path)
        if not self.scenario.wind:
            return targets, np.zeros((1, 1, 3))
        return targets, wind_series(self.scenario.wind, len(seeds), steps, self.rate_hz, air)

    def _start(self, seeds: Seeds, first: Array) -> tuple[Array, Array, Array, Array]:
        """Position, velocity, quat_WB and body rate to begin with, from the first set-points (n, 11)."""
        start = self.scenario.start
        angles = np.array(
            [np.random.default_rng(child(s, BEGINNING)).uniform(-np.pi, np.pi, 3) for s in seeds]
        )
        course, lean, spin = np.stack(
            [np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1
        ).swapaxes(0, 1)
        heading = quat_from_euler(0.0, 0.0, first[:, 9])
        return (
            first[:, :3] + start.offset,
            first[:, 3:6] + start.speed * course,
            quat_multiply(heading, quat_from_rotvec(math.radians(start.tilt_deg) * lean)),
            math.radians(start.rate_deg) * spin,
        )


@njit(cache=True, inline="always")
def look_up(k, targets, winds, target, air):
    """Copy each flight's set-point and wind of its sample k (n,); the last one holds for ever."""
    for i in range(k.shape[0]):
        target[i] = targets[min(i, targets.shape[0] - 1), min(k[i], targets.shape[1] - 1)]
        air[i] = winds[min(i, winds.shape[0] - 1), min(k[i], winds.shape[1] - 1)]


@njit(cache=True, inline="always")
def follow(
    k, targets, winds, target, air, limits, position, quat, ang_vel, down, cause
):  # fmt: skip
    """`look_up`, then `judge`."""
    look_up(k, targets, winds, target, air)
    return judge(limits, position, quat, ang_vel, target, down, cause)


@njit(cache=True, inline="always")
def judge(limits, position, quat, ang_vel, target, down, cause):
    """Write which vehicles are down now, and why, and return how many; `cause` keeps the first reason.

    limits: cosine of the largest tilt, lowest height [m], largest distance from the set-point [m].
    """
    fallen = 0
    for i in range(position.shape[0]):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        cos_tilt = 1.0 - 2.0 * (quat[i, 1] ** 2 + quat[i, 2] ** 2)
        apart = math.sqrt((x - target[i, 0]) ** 2 + (y - target[i, 1]) ** 2 + (z - target[i, 2]) ** 2)
        rate = ang_vel[i, 0] ** 2 + ang_vel[i, 1] ** 2 + ang_vel[i, 2] ** 2
        down[i] = FLYING
        if not (rate < 1e4 and apart < 1e6):  # false for NaN as well
            down[i] = DIVERGED
        elif cos_tilt < limits[0]:
            down[i] = TILTED
        elif z < limits[1]:
            down[i] = GROUNDED
        elif apart > limits[2]:
            down[i] = AWAY
        if cause[i] == FLYING:
            cause[i] = down[i]
        fallen += down[i] != FLYING
    return fallen
