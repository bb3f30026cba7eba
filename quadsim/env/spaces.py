"""Actions and observations of the environments, and their conversion from and to records of a flight."""

from functools import cache

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from ..control.records import ATTITUDE, POSITION, RATE, ROTOR, VELOCITY, Level
from ..flight.world import FLYING
from ..runs.compiled import njit
from ..vehicle import GRAVITY, Vehicle

POSITION_LIMIT, VELOCITY_LIMIT, ACCELERATION_LIMIT, RATE_LIMIT = 100.0, 50.0, 50.0, 50.0
OBSERVATION_LIMIT = np.repeat(
    [POSITION_LIMIT, VELOCITY_LIMIT, ACCELERATION_LIMIT, np.pi, 1.0, RATE_LIMIT], [3, 3, 3, 3, 2, 3]
)
"""Largest magnitude of each observation; larger values are clipped."""


@cache
def outcome_dtype(rotors: int) -> np.dtype:
    """Return the record type of a step's outcome: the quantities of `QuadrotorEnv`, information first."""
    return np.dtype(
        [
            ("attitude", "f8", 3),
            ("estimate", "f8", 2),
            ("attitude_error", "f8"),
            ("position", "f8", 3),
            ("velocity", "f8", 3),
            ("wind", "f8", 3),
            ("rotor_vel", "f8", rotors),
            ("position_cost", "f8"),
            ("velocity_cost", "f8"),
            ("reward", "f8"),
            ("observation", "f4", OBSERVATION_LIMIT.shape),
            ("crashed", "?"),
            ("over", "?"),
        ],
        align=True,
    )


INFORMATION = (outcome_dtype(4).names or ())[:-4]
"""Fields of an outcome that agents do not observe."""
ACTION_SCALE: dict[Level, tuple[float, ...]] = {
    "position": (1.0, 1.0, 1.0, np.pi),
    "velocity": (3.0, 3.0, 3.0, np.pi),
    "attitude": (0.6, 0.6, np.pi, GRAVITY),
    "rate": (6.0, 6.0, 2.0, GRAVITY),
    "rotor": (1.0,),
}
"""Meaning of an action of 1 at each level; for rotors, the difference between highest speed and hover
speed."""


OBSERVATION_SPACE = Box(
    -OBSERVATION_LIMIT.astype(np.float32), OBSERVATION_LIMIT.astype(np.float32), dtype=np.float32
)
"""Observation space of one vehicle."""


def action_scale(level: Level, vehicle: Vehicle) -> NDArray[np.float64]:
    """Return the meaning of an action of 1 in each of its numbers."""
    scale = np.array(ACTION_SCALE[level])
    if level == "rotor":
        span = vehicle.motor.omega_max - vehicle.hover_rotor_vel
        scale = np.repeat(scale, len(vehicle.rotors)) * span
    return scale


@njit(cache=True)
def to_command(level, action, scale, hover_rotor_vel, loops):
    """Write actions (n, numbers) as commands to the loops; return False if an action is not finite."""
    u = np.empty(scale.size)
    for i in range(action.shape[0]):
        wanted, out, c = loops[i].flight.target, loops[i].set_point, loops[i].controller
        for j in range(scale.size):
            if not np.isfinite(action[i, j]):
                return False
            u[j] = min(max(action[i, j], -1.0), 1.0) * scale[j]
        if level == POSITION:
            for j in range(3):
                out.position[j] = wanted.position[j] + u[j]
            out.yaw = wanted.yaw + u[3]
        elif level == VELOCITY:
            for j in range(3):
                out.velocity[j] = wanted.velocity[j] + u[j]
            out.yaw = wanted.yaw + u[3]
        elif level == ATTITUDE:
            c.attitude_cmd[0], c.attitude_cmd[1], c.attitude_cmd[2] = u[0], u[1], wanted.yaw + u[2]
            c.thrust_cmd = GRAVITY + u[3]
        elif level == RATE:
            c.rate_cmd[0], c.rate_cmd[1], c.rate_cmd[2] = u[0], u[1], u[2]
            c.thrust_cmd = GRAVITY + u[3]
        elif level == ROTOR:
            for j in range(scale.size):
                c.rotor_vel_cmd[j] = hover_rotor_vel + u[j]
    return True


@njit(cache=True)
def _clip(value, limit):
    return min(max(value, -limit), limit)


@njit(cache=True)
def observe(loops, steps, done, like):
    """Return the outcome of a step, new records of the type of `like` (n,), and the number of ended episodes.

    On entry, `done` (n,) marks episodes that ended before this step; their reward is 0. On return, `done`
    marks episodes that have ended now.
    """
    outcomes, ended = np.empty_like(like), 0
    for i in range(outcomes.shape[0]):
        row, flight, m, p = outcomes[i], loops[i].flight, loops[i].measured, loops[i].vehicle
        out, s, wanted = row.observation, p.state, flight.target
        distance = speed = 0.0  # squared errors
        for j in range(3):
            out[j] = _clip(wanted.position[j] - m.position[j], POSITION_LIMIT)
            out[3 + j] = _clip(wanted.velocity[j] - m.velocity[j], VELOCITY_LIMIT)
            out[6 + j] = _clip(wanted.acceleration[j], ACCELERATION_LIMIT)
            out[14 + j] = _clip(m.gyro[j], RATE_LIMIT)
            distance += (wanted.position[j] - s.position[j]) ** 2
            speed += (wanted.velocity[j] - s.velocity[j]) ** 2
            row.position[j], row.velocity[j], row.wind[j] = s.position[j], s.velocity[j], flight.wind[j]
        row.attitude_error = 0.0
        for j in range(2):
            out[9 + j] = _clip(m.roll_pitch[j], np.pi)
            row.attitude[j], row.estimate[j] = p.roll_pitch[j], m.roll_pitch[j]
            row.attitude_error += 0.5 * abs(m.roll_pitch[j] - p.roll_pitch[j])
        for j in range(s.rotor_vel.shape[0]):
            row.rotor_vel[j] = s.rotor_vel[j]
        error = wanted.yaw - m.yaw
        out[11], out[12], out[13] = np.arctan2(np.sin(error), np.cos(error)), np.cos(m.yaw), np.sin(m.yaw)
        row.attitude[2], row.position_cost, row.velocity_cost = p.yaw, distance, 0.1 * speed
        row.crashed, row.over = flight.cause != FLYING, m.k >= steps
        row.reward = 0.0 if row.crashed or done[i] else 1.0 / (1.0 + distance + 0.1 * speed)
        done[i] = row.crashed or row.over
        ended += done[i]
    return outcomes, ended
