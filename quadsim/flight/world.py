"""The record of one closed loop (vehicle, IMU, measured state, controller, flight), and its compiled step."""

import math
from functools import cache

import numpy as np

from ..control.cascade import control
from ..control.records import MEASURED, SET_POINT, controller_dtype
from ..imu.kernel import ACCEL, GYRO, IMU, measure
from ..motion.rotors import vehicle_dtype
from ..plant import fly, update_truth
from ..runs.compiled import njit

FLYING, TILTED, GROUNDED, OUT_OF_BOUNDS, DIVERGED = range(5)
CAUSES = ("", "tilted over", "hit the ground", "flew away", "diverged")
"""Why a flight ended, by the codes above."""

PLAN = np.dtype([("target", SET_POINT), ("wind", "f8", 3), ("attitude_error", "f8", 2)])
"""What is planned for a sample: the set-point, the wind that follows, world axes [m/s], and the error of the
roll and pitch of the truth that a controller without an estimator gets [rad]."""
FLIGHT = np.dtype(
    [
        ("min_cos_tilt", "f8"),  # limits of flight: cosine of the largest tilt,
        ("min_altitude", "f8"),  # lowest height [m]
        ("max_distance", "f8"),  # and largest distance from the set-point [m]
        ("target", SET_POINT),  # of the current sample
        ("wind", "f8", 3),
        ("crashed", "i8"),  # why it is down at this sample, and
        ("cause", "i8"),  # why it first was
    ],
    align=True,
)


@cache
def loop_dtype(rotors: int) -> np.dtype:
    """The record of one closed loop: everything about its vehicle, sensors and controller."""
    return np.dtype(
        [
            ("vehicle", vehicle_dtype(rotors)),
            ("imu", IMU),
            ("measured", MEASURED),
            ("set_point", SET_POINT),
            ("controller", controller_dtype(rotors)),
            ("flight", FLIGHT),
        ],
        align=True,
    )


NO_NOISE = np.empty((1, 0, 0, 3))
"""Of no IMU."""


@njit(cache=True)
def start_one(level, loop):
    """Wind and control of one vehicle: the count of samples increases, and its rotors get their command."""
    for axis in range(3):
        loop.vehicle.wind[axis] = loop.flight.wind[axis]
    loop.measured.k += 1
    control(level, loop.set_point, loop.measured, loop.controller)


@njit(cache=True)
def look_up(loop, plan):
    """Copy the plan's set-point and wind of a flight's sample k; the last ones hold from then on."""
    flight, now = loop.flight, plan[min(loop.measured.k, plan.shape[0] - 1)]
    flight.target = now.target
    loop.set_point = now.target
    for axis in range(3):
        flight.wind[axis] = now.wind[axis]
    for axis in range(2):
        loop.measured.roll_pitch[axis] += now.attitude_error[axis]


@njit(cache=True)
def judge(loop):
    """Write whether a vehicle is down now, and why; `cause` keeps the first reason."""
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


@njit(cache=True)
def sense_one(loop, plan, noise, at, x):
    """Truth, sample of the IMU, the plan's next sample and the judgement of crashes, of one vehicle.

    Args:
        loop: Record of `loop_dtype`.
        plan: (T,) records of `PLAN`.
        noise: (NOISES, block, 3) standard normal numbers of its IMU; without an IMU, of length 0.
        at: Place of this sample in the block.
        x: (2, 3) memory.
    """
    p, m = loop.vehicle, loop.measured
    update_truth(p)
    for axis in range(3):
        m.position[axis], m.velocity[axis], m.gyro[axis] = p.position[axis], p.velocity[axis], p.ang_vel[axis]
    m.roll_pitch[0], m.roll_pitch[1], m.yaw = p.roll_pitch[0], p.roll_pitch[1], p.yaw
    if noise.shape[0] > 0:
        for axis in range(3):
            x[GYRO, axis], x[ACCEL, axis] = p.ang_vel[axis], p.specific_force[axis]
        measure(loop.imu, noise[:, at], x, p.ang_acc, p.rotor_vel)
        for axis in range(3):
            m.gyro[axis] = loop.imu.reading[GYRO, axis]
    look_up(loop, plan)
    judge(loop)


@njit(cache=True)
def start(level, loops):
    """`start_one` for all, (n,) records."""
    for i in range(loops.shape[0]):
        start_one(level, loops[i])


@njit(cache=True)
def step(level, loops, plans, substeps, noise, at):
    """One sample of all vehicles, but for the estimate; returns how many are down.

    Args:
        level: Number of the level of the command in the records.
        loops: (n,) records of `loop_dtype`.
        plans: (n, T) records of `PLAN`.
        substeps: Steps of integration; none where the vehicles have moved already.
        noise: (n, NOISES, block, 3) of the IMUs, or `NO_NOISE`.
        at: Place of this sample in the block.
    """
    crashed, x = 0, np.empty((2, 3))
    for i in range(loops.shape[0]):
        loop = loops[i]
        if substeps > 0:
            start_one(level, loop)
            fly(loop.vehicle, loop.controller.rotor_vel_cmd, substeps)
        sense_one(loop, plans[i], noise[min(i, noise.shape[0] - 1)], at, x)
        crashed += loop.flight.crashed != FLYING
    return crashed
