"""Flights to imitate: set-points and readings, and what the teacher would ask for at the true state.

The teacher is the cascade's levels of attitude and body rate, which read the true attitude and body rate. Its
integral is replaced by its limit, the disturbance of the angular acceleration, averaged over
`OBSERVED_S`: an integral would wind up on a student's errors. How its set-point turns it feeds forward: by
the trajectory and by the chirps that are added, not by jumps. The teacher flies, the student, or now one and
then the other (DAgger).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.control.controller import SpikingController, follow, gravity_of
from quadsim.control.cascade import MAX_TRIM, follow_attitude
from quadsim.control.records import POSITION
from quadsim.flight.domain import domains, scale_wind
from quadsim.flight.loop import FlightLoop
from quadsim.flight.mission import planned
from quadsim.flight.recipe import Recipe
from quadsim.rotation import quat_from_euler, quat_from_rotvec, quat_multiply
from quadsim.runs.compiled import njit
from quadsim.seeding import child
from quadsim.vehicle import GRAVITY

from ..config import ControlSettings
from .excitation import STANDARD, Excitation, rotor_effect, set_point_excitation, torque_excitation

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
MOTION, BODY, AIR, IMU, EXCITATION = range(5)
"""Children of a flight's seed."""
MAX_TILT_DEG, MAX_DISTANCE, MAX_RATE = 80.0, 40.0, 30.0
"""Where a flight ends: tilt [deg], distance from the set-point [m], body rate [rad/s]."""
OBSERVED_S = 0.4
"""Time constant of the teacher's disturbance [s]."""
PART_S = 0.5
"""Time after which another may fly [s]."""
SIGNALS = ("gyro", "accel", "set_point", "target")
RATE_HZ = 200.0


@dataclass(frozen=True)
class ControlFlights:
    """n flights of T samples, float32; what comes after `end` is not valid."""

    gyro: Float32
    """Measured body rate (n, T, 3) [rad/s]."""
    accel: Float32
    """Specific force at rest at the attitude that is read, (n, T, 3) [m/s²]."""
    set_point: Float32
    """Roll, pitch [rad], yaw rate [rad/s] and thrust per mass [m/s²], (n, T, 4)."""
    target: Float32
    """Angular acceleration that the teacher asks for, (n, T, 3) [rad/s²]."""
    end: NDArray[np.int64]
    """Valid samples (n,): all, or those before a crash."""
    error_deg: Array
    """Root mean square over a flight of the angle between the thrust axes commanded and true, (n,) [deg]."""

    def __len__(self) -> int:
        """Number of flights."""
        return len(self.gyro)

    @property
    def crashes(self) -> int:
        """How many ended early."""
        return int(np.sum(self.end < self.gyro.shape[1]))


def joined(parts: Sequence[ControlFlights]) -> ControlFlights:
    """All flights of several sets of equal length."""
    return ControlFlights(*(np.concatenate(each) for each in zip(*map(astuple, parts), strict=True)))


@njit(cache=True)
def teach_all(targets, measured, set_points, teachers):
    """`follow_attitude` for records (n,) of targets, of measured truth and of teachers, set-points (n, 4)."""
    for i in range(targets.shape[0]):
        follow_attitude(POSITION, targets[i], measured[i], set_points[i], teachers[i])


def with_motion(targets: NDArray[np.void], added: Array, yaw: Array) -> NDArray[np.void]:
    """Targets (n,) whose thrust axis turns by what is added to roll and pitch, too.

    Args:
        targets: Records of `quadsim.control.records.SET_POINT`.
        added: Roll and pitch, small, in the first two columns, (n, k) [rad].
        yaw: Headings that they are added at, (n,) [rad].
    """
    out, (sine, cosine) = targets.copy(), (np.sin(yaw), np.cos(yaw))
    forward, left = GRAVITY * added[:, 1], -GRAVITY * added[:, 0]
    out["acceleration"][:, 0] += cosine * forward - sine * left
    out["acceleration"][:, 1] += sine * forward + cosine * left
    return out


class Pilot:
    """Who flies: an attitude controller that asks teacher and student, lets one answer, and records.

    Args:
        steps: Samples to record.
        jumps, chirps: Added to the set-points of roll, pitch and yaw rate, (n, steps, 3).
        disturbance: Added to the angular acceleration that is asked for, (n, steps, 3) [rad/s²].
        student: A controller; None: the teacher flies alone.
        by_student: Samples at which the student flies, (n, steps).
        config: Of the run.
    """

    def __init__(
        self,
        steps: int,
        jumps: Array,
        chirps: Array,
        disturbance: Array,
        student: SpikingController | None,
        by_student: NDArray[np.bool_],
        config: ControlSettings,
    ) -> None:
        n = len(jumps)
        self.excitation, self.chirps, self.disturbance = jumps + chirps, chirps, disturbance
        self.student, self.by_student, self.config = student, by_student, config
        self.k = 0
        self.log = {
            name: np.zeros((n, steps, 4 if name == "set_point" else 3), np.float32) for name in SIGNALS
        }

    def attach(self, loop: FlightLoop) -> None:
        """The loop that it flies in, once that exists."""
        self.loop = loop
        self.teachers = loop.controller.records.copy()
        self.limits = self.teachers["max_ang_acc"].copy()
        self.teachers["gains"]["rate_integral"] = self.teachers["gains"]["yaw_rate_integral"] = 0.0
        self.asked = np.zeros_like(self.limits)
        self.forget = 1.0 - math.exp(-1.0 / (loop.rate_hz * OBSERVED_S))

    def reset(self, n: int) -> None:
        """Start n vehicles."""
        if self.student is not None:
            self.student.reset(n)

    def restart(self, ids: NDArray[np.int64]) -> None:
        """Start some vehicles again."""
        if self.student is not None:
            self.student.restart(ids)
        for name in ("trim", "has_last_axis"):
            self.teachers[name][ids] = 0
        self.asked[ids] = 0.0

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array) -> Array:
        """As of an `AttitudeController`; the truth is the loop's."""
        wanted = set_point.copy()
        wanted[:, :3] += self.excitation[:, self.k]
        wanted = follow(self.config.set_point, wanted[:, None]).followed[:, 0]
        truth = self.loop.records["measured"].copy()
        trim = self.teachers["trim"]
        trim += self.forget * (self.asked - self.loop.plant.ang_acc - trim)
        trim[:] = np.clip(trim, -MAX_TRIM * self.limits, MAX_TRIM * self.limits)
        truth["gyro"], truth["roll_pitch"] = self.loop.plant.ang_vel, self.loop.plant.roll_pitch
        turning = with_motion(self.loop.records["set_point"], self.chirps[:, self.k], self.loop.plant.yaw)
        teach_all(turning, truth, wanted, self.teachers)
        taught = np.clip(self.teachers["ang_acc_cmd"], -self.limits, self.limits)
        for name, values in zip(SIGNALS, (gyro, gravity_of(roll_pitch), wanted, taught), strict=True):
            self.log[name][:, self.k] = values
        action = np.concatenate([taught, set_point[:, 3:]], 1)
        if self.student is not None:
            own = self.student.update(wanted, gyro, accel, roll_pitch)
            action = np.where(self.by_student[:, self.k, None], own, action)
        action[:, :3] += self.disturbance[:, self.k]
        self.asked = np.clip(action[:, :3], -self.limits, self.limits)
        self.k += 1
        self.wanted = wanted
        return action


def fly(
    config: ControlSettings,
    flights: Recipe,
    seeds: Sequence[np.random.SeedSequence],
    student: SpikingController | None = None,
    teacher_share: float = 0.0,
    excitation: Excitation = STANDARD,
) -> ControlFlights:
    """Fly, and label by the teacher.

    Args:
        config: Of the run.
        flights: What to fly.
        seeds: One for each flight.
        student: Who flies; None: the teacher.
        teacher_share: Share of the time at which the teacher flies all the same.
        excitation: What is added to the flights.
    """
    n, steps = len(seeds), round(config.flight_s * RATE_HZ)
    draws = [np.random.default_rng(child(seed, EXCITATION)) for seed in seeds]
    motion, air = ([child(seed, part) for seed in seeds] for part in (MOTION, AIR))
    plans = planned(flights.trajectory, flights.wind, steps, RATE_HZ, motion, air)
    bodies = [child(seed, BODY) for seed in seeds]
    drawn = domains(flights.vehicle, flights.imu, flights.randomisation, bodies)
    scale_wind(plans, drawn)
    size = np.stack([rng.uniform() ** 2 for rng in draws])[:, None]
    added_motion = [set_point_excitation(excitation, steps, RATE_HZ, rng) for rng in draws]
    pilot = Pilot(
        steps,
        size[:, None] * np.stack([each.jumps for each in added_motion]),
        size[:, None] * np.stack([each.chirps for each in added_motion]),
        size[:, None] * np.stack([torque_excitation(excitation, steps, RATE_HZ, rng) for rng in draws]),
        student,
        np.stack([_turns(1.0 - teacher_share, steps, rng) for rng in draws]),
        config,
    )
    loop = FlightLoop(
        [each.vehicle for each in drawn],
        n,
        rate_hz=RATE_HZ,
        imu=[each.imu for each in drawn],
        seed=[child(seed, IMU) for seed in seeds],
        nominal=flights.vehicle,
        controller=lambda rate_hz, vehicle: pilot,
    )
    effect = np.stack([rotor_effect(excitation, len(flights.vehicle.rotors), rng) for rng in draws])
    pilot.attach(loop)
    tilts = np.stack([rng.uniform(-1.0, 1.0, 3) for rng in draws])
    tilts = math.radians(excitation.start_tilt_deg) * size * tilts * [1.0, 1.0, 0.0] / math.sqrt(2.0)
    first = plans["target"][:, 0]
    heading = quat_from_euler(0.0, 0.0, first["yaw"])
    loop.reset(first["position"], first["velocity"], quat_multiply(heading, quat_from_rotvec(tilts)))
    loop.plant.rotor_effect[:] = effect
    end, squares = np.full(n, steps), np.zeros(n)
    for k in range(steps):
        target = plans["target"][:, k]
        loop.move("position", target, plans["wind"][:, k])
        error = thrust_axis_error(pilot.wanted, loop.plant.quat, loop.plant.yaw)
        squares += np.where(end == steps, error**2, 0.0)
        down = _down(loop, target)
        if down.size:
            end[down] = np.minimum(end[down], k)
            loop.reset(target["position"][down], target["velocity"][down], ids=down)
        loop.sense()
    error_deg = np.degrees(np.sqrt(squares / np.maximum(end, 1)))
    return ControlFlights(**pilot.log, end=end, error_deg=error_deg)


def _down(loop: FlightLoop, target: NDArray[np.void]) -> NDArray[np.int64]:
    """Vehicles (k,) that have tilted over, are out of bounds or diverge."""
    plant = loop.plant
    up = 1.0 - 2.0 * (plant.quat[:, 1] ** 2 + plant.quat[:, 2] ** 2)
    distance = np.linalg.norm(plant.position - target["position"], axis=1)
    rate = np.linalg.norm(plant.ang_vel, axis=1)
    well = (up > math.cos(math.radians(MAX_TILT_DEG))) & (distance < MAX_DISTANCE) & (rate < MAX_RATE)
    return np.flatnonzero(~well)


def thrust_axis_error(set_point: Array, quat: Array, yaw: Array) -> Array:
    """Angle between the thrust axes of set-points (n, 4) and of attitudes (n, 4), (n,) [rad]."""
    wanted = thrust_axis(quat_from_euler(set_point[:, 0], set_point[:, 1], yaw))
    return np.arccos(np.clip(np.sum(wanted * thrust_axis(quat), axis=1), -1.0, 1.0))


def thrust_axis(quat: Array) -> Array:
    """The body's z axis in world axes, (n, 3)."""
    w, x, y, z = quat.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _turns(share: float, steps: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Samples (steps,) at which one flies that flies a share of the time."""
    length = max(1, round(PART_S * RATE_HZ))
    return np.repeat(rng.random(-(-steps // length)) < share, length)[:steps]
