"""The record of one closed loop (vehicle, IMU, measured state, controller, flight), and the compiled step."""

import math
from functools import cache

import numpy as np

from ..control.cascade import control
from ..control.records import MEASURED, SET_POINT, controller_dtype
from ..external import deliver
from ..imu.kernel import GYRO, IMU, SENSORS, measure
from ..motion.rotors import vehicle_dtype
from ..plant import move_freely, update_truth
from ..runs.compiled import njit

FLYING, TILTED, GROUNDED, OUT_OF_BOUNDS, DIVERGED = range(5)
CAUSES = ("", "tilted over", "hit the ground", "flew away", "diverged")
"""Causes of a crash in words, by the codes above."""

PLAN = np.dtype([("target", SET_POINT), ("wind", "f8", 3), ("attitude_error", "f8", 2)])
"""Plan for a sample: the set-point, the wind until the next sample in world axes [m/s], and the error that is
added to the true roll and pitch if there is no estimator [rad]."""
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
    """Return the type of the record of one closed loop, with its vehicle, sensors and controller."""
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


NO_NOISE = np.empty((1, 0, 0, 3))  # of no IMU


@njit(cache=True)
def start_one(level, loop):
    """Apply wind and control to one vehicle: advance its sample count and set its rotor commands."""
    state, command = loop.vehicle.state, loop.controller.rotor_vel_cmd
    for axis in range(3):
        state.wind[axis] = loop.flight.wind[axis]
    loop.measured.k += 1
    control(level, loop.set_point, loop.measured, loop.controller)
    for rotor in range(command.shape[0]):
        state.rotor_vel_cmd[rotor] = command[rotor]


@njit(cache=True)
def look_up(loop, plan):
    """Copy set-point and wind for sample k from the plan; after its end, the last ones are used."""
    flight, now = loop.flight, plan[min(loop.measured.k, plan.shape[0] - 1)]
    flight.target = now.target
    loop.set_point = now.target
    for axis in range(3):
        flight.wind[axis] = now.wind[axis]
    for axis in range(2):
        loop.measured.roll_pitch[axis] += now.attitude_error[axis]


@njit(cache=True)
def judge(loop):
    """Record whether a vehicle is beyond its crash limits; `cause` keeps the first cause."""
    flight = loop.flight
    s, wanted = loop.vehicle.state, flight.target.position
    p, q, w = s.position, s.quat, s.ang_vel
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
def sense_one(loop, plan, noise, at, x, log):
    """Update the truth, sample the IMU, read the next sample of the plan and detect a crash.

    The arguments are those of `step`, for one vehicle; x is memory (SENSORS, 3).
    """
    p, s, m = loop.vehicle, loop.vehicle.state, loop.measured
    update_truth(p)
    for axis in range(3):
        m.position[axis], m.velocity[axis], m.gyro[axis] = s.position[axis], s.velocity[axis], s.ang_vel[axis]
    m.roll_pitch[0], m.roll_pitch[1], m.yaw = p.roll_pitch[0], p.roll_pitch[1], p.yaw
    if noise.shape[0] > 0:
        measure(loop.imu, noise[:, at], s, x)
        for axis in range(3):
            m.gyro[axis] = loop.imu.reading[GYRO, axis]
    look_up(loop, plan)
    judge(loop)
    place = m.k - plan.shape[0] + log.shape[0]
    if 0 <= place < log.shape[0]:
        log[place] = s


@njit(cache=True)
def start(level, loops):
    """Run `start_one` for all vehicles, (n,) records."""
    for i in range(loops.shape[0]):
        start_one(level, loops[i])


@njit(cache=True)
def step(level, loops, plans, samples, substeps, noise, at, logs, externals, errors, queues):
    """Advance all vehicles by some samples, without the estimate.

    Args:
        level: Number of the level of the command in the records.
        loops: (n,) records of `loop_dtype`.
        plans: (n, T) records of `PLAN`.
        samples: Number of samples; more than one is only possible without IMU and external sensor.
        substeps: Integration steps per sample; 0 if the vehicles have already moved.
        noise: (n, NOISES, block, 3) standard normal numbers of the IMUs, or `NO_NOISE`.
        at: Index of this sample in the block.
        logs: (n, t) records of `quadsim.motion.rotors.state_dtype`, for the last t samples of the plans.
        externals: (n,) records of `quadsim.external.SENSOR`, or (0,) without external sensors.
        errors: (n, BLOCK, NUMBERS) standard normal numbers of the external sensors.
        queues: (n, slots, NUMBERS) measurements of the external sensors that have not arrived yet.

    Returns:
        Number of crashed vehicles, and number of external sensors that need new random numbers.
    """
    crashed, spent, x = 0, 0, np.empty((SENSORS, 3))
    for i in range(loops.shape[0]):
        loop = loops[i]
        for _ in range(samples):
            if substeps > 0:
                start_one(level, loop)
                move_freely(loop.vehicle, substeps)
            sense_one(loop, plans[i], noise[min(i, noise.shape[0] - 1)], at, x, logs[i])
            if externals.shape[0] > 0:
                spent += deliver(externals[i], errors[i], queues[i], loop.measured)
        crashed += loop.flight.crashed != FLYING
    return crashed, spent
