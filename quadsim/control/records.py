"""Levels of the cascade, and the records of its set-points, measured states and controllers."""

from functools import cache
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from ..vehicle import Gains

Command: TypeAlias = NDArray[Any]
"""A command: floats, (n, width of the level), or records, (n,)."""
Level = Literal["position", "velocity", "attitude", "rate", "rotor"]
LEVELS: tuple[Level, ...] = get_args(Level)
POSITION, VELOCITY, ATTITUDE, RATE, ROTOR = range(5)

SET_POINT = np.dtype(
    [
        ("position", "f8", 3),
        ("velocity", "f8", 3),
        ("acceleration", "f8", 3),
        ("yaw", "f8"),
        ("yaw_rate", "f8"),
    ]
)
"""Set-point of the position level, world axes; the velocity level uses only velocity and yaw."""
MEASURED = np.dtype(
    [
        ("k", "i8"),  # count of samples since the vehicle started
        ("position", "f8", 3),  # world [m]
        ("velocity", "f8", 3),  # world [m/s]
        ("yaw", "f8"),
        ("roll_pitch", "f8", 2),  # estimated [rad]
        ("gyro", "f8", 3),  # body rate, the last valid sample [rad/s]
    ]
)
"""State of a vehicle as measured by its sensors, the input of its controller."""


@cache
def controller_dtype(rotors: int) -> np.dtype:
    """Return the type of a controller's record, which holds constants, command and state."""
    return np.dtype(
        [
            ("dt", "f8"),
            ("gains", [(name, "f8") for name in Gains.model_fields]),
            ("mass", "f8"),
            ("inertia", "f8", 3),
            ("max_ang_acc", "f8", 3),
            ("max_rotor_vel", "f8"),
            ("per_thrust", "f8", rotors),  # squared rotor speeds that make a unit of thrust,
            ("per_roll", "f8", rotors),  # and of torque
            ("per_pitch", "f8", rotors),
            ("per_yaw", "f8", rotors),
            ("attitude_cmd", "f8", 3),  # roll, pitch, yaw [rad]
            ("rate_cmd", "f8", 3),  # body axes [rad/s]
            ("thrust_cmd", "f8"),  # per mass [m/s²]
            ("rotor_vel_cmd", "f8", rotors),  # the result [rad/s]
            ("thrust_axis", "f8", 3),  # commanded by the levels above the rate, world axes
            ("wind_acc", "f8", 3),  # integral of the velocity error, world axes [m/s²]
            ("ang_acc_cmd", "f8", 3),  # commanded, body axes [rad/s²]
            ("trim", "f8", 3),  # integral of the rate error, body axes [rad/s²]
            ("last_axis", "f8", 3),  # thrust axis of the last set-point, world axes
            ("has_last_axis", "i8"),
        ],
        align=True,
    )
