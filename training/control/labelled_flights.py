"""Flights for imitation: set-points and readings, with the teacher's commands for the true state as labels.

The teacher is the cascade with the true attitude and body rate. Its integral of the body rate would wind up
on a student's errors, and is replaced by its limit, the disturbance of the angular acceleration averaged over
`OBSERVED_S`. The teacher, the student, or both in turn (DAgger) fly.
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
"""Limits at which a flight ends: tilt [rad] and distance from the set-point [m]."""
OBSERVED_S, TURN_S = 0.4, 0.5
"""Averaging time of the disturbance for the teacher, and time after which teacher and student can switch
[s]."""
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
class DisturbedController:
    """An attitude controller that gives the disturbed commands of a teacher or a student.

    The teacher reads the true state and the cascade's body-rate command from `loop`. `set_point` (n, 4) and
    `taught` (n, 3) are its last input and command, even if the student flew.
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
        """Compute the command, as an `AttitudeController` does."""
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


def fly_labelled(
    recipe: Recipe,
    seeds: Sequence[np.random.SeedSequence],
    duration_s: float,
    student: AttitudeController | None = None,
    teacher_share: float = 0.0,
    excitation: Excitation = STANDARD,
) -> NDArray[np.void]:
    """Simulate one flight per seed with labels by the teacher; return records (n, T) of `SAMPLE`.

    The teacher flies for the share `teacher_share` of the time, the student otherwise. Without a student, the
    teacher always flies.
    """
    n, steps = len(seeds), round(duration_s * RATE_HZ)
    draws = [np.random.default_rng(seed) for seed in children(seeds, PILOT)]
    sizes = [rng.uniform() ** 2 for rng in draws]
    disturbances = [disturbance(excitation, *each) for each in zip(sizes, [steps] * n, draws, strict=True)]
    turns = [rng.random(math.ceil(steps / (TURN_S * RATE_HZ))) >= teacher_share for rng in draws]
    by_student = np.repeat(turns, round(TURN_S * RATE_HZ), axis=1)
    pilot = DisturbedController(student, by_student, np.stack(disturbances))
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
