"""A mission: n flights of one scenario on one estimator, one sample at a time, and who judges their crashes.

The closed-loop benchmark and the Gymnasium environments both fly missions. A flight depends on the scenario,
the estimator and its own seed, and on nothing else: neither on n, nor on the flights beside it.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..config.ranges import steps_of
from ..control.cascade import LEVELS, SET_POINT, Command, Level
from ..control.own import MakeController
from ..estimator import AttitudeEstimator
from ..external import ExternalSensor, ExternalSpec, load_external
from ..imu.spec import load_imu
from ..plant import fly
from ..rotation import quat_from_euler, quat_from_rotvec, quat_multiply
from ..runs.compiled import njit
from ..seeding import child
from ..trajectory.reference import reference
from ..vehicle import load_vehicle, with_drag
from ..wind import wind_series
from .faults import VehicleFaults, displaced, sensor_faults
from .loop import FlightLoop, sense_one, start_one
from .scenario import Scenario

Array = NDArray[np.float64]
Seeds = Sequence[np.random.SeedSequence]

FLYING, TILTED, GROUNDED, OUT_OF_BOUNDS, DIVERGED = range(5)
CAUSES = ("", "tilted over", "hit the ground", "flew away", "diverged")
"""Why a flight ended, by the codes above."""

PLAN = np.dtype([("target", SET_POINT), ("wind", "f8", 3)])
"""What is planned for a sample: the set-point, and the wind that follows, world axes [m/s]."""
TRAJECTORY, AIR, SENSOR, BEGINNING, FAULT, EXTERNAL = range(6)
"""Children of a flight's seed, one for each component that draws from it."""


class Mission:
    """n flights of a scenario. `begin` them, then `step` until `k` reaches `steps`.

    `loop` holds plant, sensors, estimate and controller at the current sample; `k` (n,) counts each flight's
    samples; `target` (n,), records of `SET_POINT`, and `air` (n, 3) are its set-point and wind; `cause` (n,)
    tells which flights have crashed, and why. What a crashed vehicle does then means nothing: it is put back
    above its set-point as often as it crashes again, so that no number overflows.

    Args:
        scenario: What to fly.
        estimator: Source of roll and pitch; None for the truth.
        n: Number of flights.
        rate_hz: Samples per second.
        duration_s: Length of a flight, instead of the scenario's.
        controller: Makes the attitude controller, see `quadsim.control.own`; None for the cascade's own.
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
        self.scenario, self.n, self.rate_hz = scenario, n, rate_hz
        self.vehicle = with_drag(load_vehicle(scenario.vehicle), scenario.drag_factor)
        self.steps = steps_of(scenario.duration_s if duration_s is None else duration_s, rate_hz)
        self._imu, self._estimator = displaced(load_imu(scenario.imu), scenario.faults), estimator
        self._external, self._controller = load_external(scenario.external), controller

    def begin(self, seeds: Seeds) -> None:
        """Begin all flights, one seed each."""
        if len(seeds) != self.n:
            raise ValueError(f"{len(seeds)} seeds for {self.n} flights; there must be one for each")
        self._plans = self._plan(seeds)
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
            engine=self.scenario.engine,
            external=external,
            controller=self._controller,
            corrupt=sensor_faults(faults, self.n, self.rate_hz, [child(seed, FAULT) for seed in seeds]),
        )
        self._faults = VehicleFaults(faults, self.loop.plant)
        self.k = self.loop.k
        self.records, self.crashed, crash = self.loop.records, 0, self.scenario.crash
        self._flights = self.records["flight"]
        self._flights["min_cos_tilt"] = math.cos(math.radians(crash.tilt_deg))
        self._flights["min_altitude"], self._flights["max_distance"] = crash.altitude, crash.distance
        self.target, self.air = self._flights["target"], self._flights["wind"]
        self.cause = self._flights["cause"]
        start, error = self._start(seeds, self._plans["target"][:, 0])
        self.loop.reset(*start, self.scenario.start.known_attitude, error)
        look_up_all(self.records, self._plans)

    def restart(self, ids: NDArray[np.int64], seeds: Seeds) -> None:
        """Restart some flights, one seed each, while the others continue; call `sense` before they are read.

        Sensor noise and faults continue with what the seed of the vehicle's first flight holds for its next.
        """
        self._plans[ids] = plans = self._plan(seeds)
        self._flights["cause"][ids] = self._flights["crashed"][ids] = FLYING
        start, error = self._start(seeds, plans["target"][:, 0])
        self._faults.restart(ids)
        self.loop.restart(ids, *start, self.scenario.start.known_attitude, error)

    def step(self, level: Level = "position", command: Command | None = None) -> None:
        """Advance by one sample, on a command at a level of the controller.

        Without one, the command is in the records of the loop, where the scenario's set-point is by default.
        """
        loop = self.loop
        if loop.plant.engine is None:
            self._prepare()
            index = self._accept(level, command)
            self.crashed = step(
                index, self.records, self._plans, loop.plant.substeps, loop.noise, loop.next_noise()
            )
            loop.estimate()
        else:
            self.move(level, command)
            self.sense()

    def move(self, level: Level = "position", command: Command | None = None) -> None:
        """The first half of `step`: control and motion."""
        self._prepare()
        index = self._accept(level, command)
        self.loop.plant.wind[:] = self.air
        self.loop.move_on(index)

    def sense(self) -> None:
        """The second half of `step`: IMU, estimate, the next set-point, and who has crashed."""
        self.loop.sense()
        self.crashed = follow_all(self.records, self._plans)

    def _accept(self, level: Level, command: Command | None) -> int:
        index = LEVELS.index(level) if command is None else self.loop.accept(level, command)
        return self.loop.steered(index)

    def _prepare(self) -> None:
        """Put crashed vehicles back above their set-points, and let the faults of vehicles act."""
        if self.crashed:
            crashed = np.flatnonzero(self._flights["crashed"])
            self.loop.plant.reset(position=self.target["position"][crashed] + [0.0, 0.0, 1.0], ids=crashed)
            self.loop.controller.reset(crashed)
        if self._faults.any:
            self._faults.apply(self.k)

    def _plan(self, seeds: Seeds) -> NDArray[np.void]:
        """Set-points and winds of whole flights, (n, steps + 1) records of `PLAN`."""
        steps = self.steps + 1
        path, air = ([child(seed, part) for seed in seeds] for part in (TRAJECTORY, AIR))
        plans = np.zeros((len(seeds), steps), PLAN)
        plans["target"] = reference(self.scenario.trajectory, steps, self.rate_hz, path)
        if self.scenario.wind:
            plans["wind"] = wind_series(self.scenario.wind, len(seeds), steps, self.rate_hz, air)
        return plans

    def _start(
        self, seeds: Seeds, first: NDArray[np.void]
    ) -> tuple[tuple[Array, Array, Array, Array], Array | None]:
        """What to begin with, from the first set-points (n,).

        Returns:
            Position, velocity, quat_WB and body rate; the error of the attitude that is given, as rotation
            vectors in world axes (n, 3) [rad], None without one.
        """
        start = self.scenario.start
        angles = np.array(
            [np.random.default_rng(child(s, BEGINNING)).uniform(-np.pi, np.pi, 4) for s in seeds]
        )
        course, tilt_axis, spin_axis, error_axis = np.stack(
            [np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1
        ).swapaxes(0, 1)
        heading = quat_from_euler(0.0, 0.0, first["yaw"])
        state = (
            first["position"] + start.offset,
            first["velocity"] + start.speed * course,
            quat_multiply(heading, quat_from_rotvec(math.radians(start.tilt_deg) * tilt_axis)),
            math.radians(start.rate_deg) * spin_axis,
        )
        return state, math.radians(
            start.attitude_error_deg
        ) * error_axis if start.attitude_error_deg else None


@njit(cache=True)
def look_up(loop, plan):
    """Copy set-point and wind of a flight's sample k; the last ones hold from then on."""
    flight, now = loop.flight, plan[min(loop.measured.k, plan.shape[0] - 1)]
    flight.target = now.target
    loop.set_point = now.target
    for axis in range(3):
        flight.wind[axis] = now.wind[axis]


@njit(cache=True)
def follow(loop, plan):
    """`look_up`, then write whether a vehicle is down now, and why; `cause` keeps the first reason.

    Args:
        loop: Record of `loop_dtype`.
        plan: (T,) records of `PLAN`.
    """
    look_up(loop, plan)
    flight = loop.flight
    p, q, w, wanted = loop.vehicle.position, loop.vehicle.quat, loop.vehicle.ang_vel, flight.target.position
    cos_tilt = 1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2)
    distance = math.sqrt((p[0] - wanted[0]) ** 2 + (p[1] - wanted[1]) ** 2 + (p[2] - wanted[2]) ** 2)
    rate = w[0] ** 2 + w[1] ** 2 + w[2] ** 2
    flight.crashed = FLYING
    if not (rate < 1e4 and distance < 1e6):  # false for NaN as well
        flight.crashed = DIVERGED
    elif cos_tilt < flight.min_cos_tilt:
        flight.crashed = TILTED
    elif p[2] < flight.min_altitude:
        flight.crashed = GROUNDED
    elif distance > flight.max_distance:
        flight.crashed = OUT_OF_BOUNDS
    if flight.cause == FLYING:
        flight.cause = flight.crashed
    return flight.crashed != FLYING


@njit(cache=True)
def look_up_all(loops, plans):
    """`look_up` for all: (n,) records of `loop_dtype`, plans (n, T) of `PLAN`."""
    for i in range(loops.shape[0]):
        look_up(loops[i], plans[i])


@njit(cache=True)
def follow_all(loops, plans):
    """`follow` for all; returns how many are down."""
    crashed = 0
    for i in range(loops.shape[0]):
        crashed += follow(loops[i], plans[i])
    return crashed


@njit(cache=True)
def step(level, loops, plans, substeps, noise, at):
    """One sample of all flights, but for the estimate; returns how many are down.

    Args:
        level: Number of the level of the command in the records.
        loops: (n,) records of `loop_dtype`.
        plans: (n, T) records of `PLAN`.
        substeps: Steps of integration a sample.
        noise: (n, NOISES, block, 3) of the IMUs.
        at: Place of this sample in the block.
    """
    crashed, x = 0, np.empty((2, 3))
    for i in range(loops.shape[0]):
        loop = loops[i]
        for axis in range(3):
            loop.vehicle.wind[axis] = loop.flight.wind[axis]
        start_one(level, loop)
        fly(loop.vehicle, loop.controller.rotor_vel_cmd, substeps)
        sense_one(loop, noise[i], at, x)
        crashed += follow(loop, plans[i])
    return crashed
