"""Flights to imitate: set-points and readings, and what the teacher would ask for at the true state.

The teacher is the cascade, with the true attitude and body rate. Its integral of the body rate is replaced by
its limit, the disturbance of the angular acceleration, averaged over `OBSERVED_S`: an integral would wind up
on a student's errors. The teacher flies, the student, or now one and then the other (DAgger).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimators.control.controller import gravity_of
from quadsim.control.attitude_controller import AttitudeController
from quadsim.control.cascade import MAX_TRIM
from quadsim.flight.loop import FlightLoop
from quadsim.flight.recipe import Recipe
from quadsim.flight.simulate import recipe_loop
from quadsim.flight.world import FLYING
from quadsim.rotation import quat_rotate
from quadsim.seeding import PILOT, children

from .excitation import RATE_HZ, STANDARD, Array, Excitation, disturbance, excite_set_points

MAX_TILT, MAX_DISTANCE = math.radians(80.0), 40.0
"""Where a flight ends: tilt [rad] and distance from the set-point [m]."""
OBSERVED_S, TURN_S = 0.4, 0.5
"""Time constant of the teacher's disturbance, and time after which another may fly [s]."""
SAMPLE = np.dtype(
    [
        ("gyro", "f4", 3),  # measured body rate [rad/s]
        ("accel", "f4", 3),  # specific force at rest at the attitude that is read [m/s²]
        ("set_point", "f4", 4),  # roll, pitch [rad], yaw rate [rad/s] and thrust per mass [m/s²]
        ("target", "f4", 3),  # angular acceleration that the teacher asks for [rad/s²]
        ("error", "f4"),  # angle between the thrust axes commanded and, a sample later, true [rad]
        ("valid", "i4"),  # 1; 0 from a crash on
    ]
)


@dataclass
class Pilot:
    """An attitude controller whose commands are a teacher's or a student's, disturbed.

    The teacher finds the truth, and the body rate that the cascade wants, in the `loop` that it flies in.
    `set_point` (n, 4) and `taught` (n, 3) are what it was given and asked for last, whoever flew.
    """

    student: AttitudeController | None  #: None: the teacher flies alone
    by_student: NDArray[np.bool_]  #: samples at which the student flies, (n, T)
    disturbance: Array  #: added to the angular acceleration that either asks for, (n, T, 3) [rad/s²]
    loop: FlightLoop = field(init=False)
    set_point: Array = field(init=False)
    taught: Array = field(init=False)

    def reset(self, n: int) -> None:
        """Start n vehicles."""
        self.asked, self.trim = np.zeros((n, 3)), np.zeros((n, 3))
        if self.student is not None:
            self.student.reset(n)

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array) -> Array:
        """As of an `AttitudeController`."""
        plant, cascade, k = self.loop.plant, self.loop.records["controller"], self.loop.k[0]
        limit, gains, self.set_point = cascade["max_ang_acc"], cascade["gains"], set_point
        self.trim += (self.asked - plant.ang_acc - self.trim) / (OBSERVED_S * RATE_HZ)
        self.trim = np.clip(self.trim, -MAX_TRIM * limit, MAX_TRIM * limit)
        gain = np.stack([gains[name] for name in ("rate", "rate", "yaw_rate")], axis=1)
        wanted = gain * (cascade["rate_cmd"] - plant.ang_vel) + self.trim
        self.taught = action = np.clip(wanted, -limit, limit)
        if self.student is not None:
            own = self.student.update(set_point, gyro, accel, roll_pitch)[:, :3]
            action = np.where(self.by_student[:, k, None], own, action)
        self.asked = np.clip(action, -limit, limit)
        return np.concatenate([action + self.disturbance[:, k], set_point[:, 3:]], axis=1)


def fly(
    recipe: Recipe,
    seeds: Sequence[np.random.SeedSequence],
    duration_s: float,
    student: AttitudeController | None = None,
    teacher_share: float = 0.0,
    excitation: Excitation = STANDARD,
) -> NDArray[np.void]:
    """Fly one flight per seed, and label it by the teacher: records (n, T) of `SAMPLE`.

    The student flies, but for `teacher_share` of the time; without one the teacher.
    """
    n, steps = len(seeds), round(duration_s * RATE_HZ)
    draws = [np.random.default_rng(seed) for seed in children(seeds, PILOT)]
    sizes = [rng.uniform() ** 2 for rng in draws]
    disturbances = [disturbance(excitation, *each) for each in zip(sizes, [steps] * n, draws, strict=True)]
    turns = [rng.random(math.ceil(steps / (TURN_S * RATE_HZ))) >= teacher_share for rng in draws]
    by_student = np.repeat(turns, round(TURN_S * RATE_HZ), axis=1)
    pilot = Pilot(student, by_student, np.stack(disturbances))
    loop = pilot.loop = recipe_loop(recipe, seeds, steps, RATE_HZ, controller=lambda *_: pilot)
    for target, size, rng in zip(loop.plans["target"], sizes, draws, strict=True):
        excite_set_points(target, excitation, size, loop.records["controller"]["gains"]["velocity"][0], rng)
    limits = loop.records["flight"]
    limits["min_cos_tilt"], limits["max_distance"] = math.cos(MAX_TILT), MAX_DISTANCE
    log = np.zeros((n, steps), SAMPLE)
    for k in range(steps):
        loop.move()
        row, measured = log[:, k], loop.measured_state
        row["gyro"], row["accel"] = measured["gyro"], gravity_of(measured["roll_pitch"])
        row["set_point"], row["target"] = pilot.set_point, pilot.taught
        thrust_axis = quat_rotate(loop.plant.quat, [0.0, 0.0, 1.0])
        cosine = np.sum(thrust_axis * loop.records["controller"]["thrust_axis"], axis=1)
        row["error"] = np.arccos(np.clip(cosine, -1.0, 1.0))
        loop.sense()
        log["valid"][:, k] = loop.cause == FLYING
        loop.put_back()
    return log
