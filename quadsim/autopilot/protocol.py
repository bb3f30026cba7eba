"""Messages between the simulator and Betaflight's SITL, which `assets/autopilot/lockstep.c` exchanges.

A request is the firmware's own two packets, the simulated state and the channels of the remote control (its
`target.h`), and text for its first serial port. A reply is its motor packet, its estimate of the attitude,
whether it is armed, and what it wrote to that port.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STATE = np.dtype(
    [
        ("timestamp", "<f8"),  # until when the firmware runs on this state [s]
        ("gyro", "<f8", 3),  # body rate, axes forward, right, down [rad/s]
        ("accel", "<f8", 3),  # gravity minus acceleration, axes forward, left, up [m/s²]
        ("quat", "<f8", 4),  # not read: the firmware computes its own
        ("velocity", "<f8", 3),  # not read, as it has no GPS
        ("position", "<f8", 3),
        ("pressure", "<f8"),  # [Pa]
    ]
)
RC = np.dtype([("timestamp", "<f8"), ("channels", "<u2", 16)])
"""Channels in µs, 1000 to 2000: roll, pitch, throttle, yaw, arm switch, mode switch; the others are free."""
REQUEST = np.dtype([("state", STATE), ("rc", RC)])
REPLY = np.dtype(
    [
        ("motors", "<f4", 4),  # commands, 0 to 1, in the order of the vehicle's rotors
        ("quat", "<f4", 4),  # estimated quat_WB; its yaw starts at 0 and drifts
        ("armed", "<u4"),
        ("arming_disabled", "<u4"),  # bits that say why it does not arm
    ]
)
MESSAGE_MAX = 8192
"""Upper bound of a message's size [bytes]."""

GYRO_COUNTS = 16.4 * 180.0 / np.pi
"""Counts of the firmware's gyroscope for a rad/s: 2000°/s are 32 800."""
ACCEL_COUNTS = 256 / 9.80665
"""Counts of its accelerometer for a m/s²."""
PRESSURE = 101325.0
CENTRE, LOW, HIGH = 1500, 1000, 2000
"""Channels: a stick in the middle, at its lower end and at its upper end [µs]."""
THROTTLE_LOW = 1050
"""`min_check` of the firmware: below, the throttle counts as closed [µs]."""


def pack(until_s: float, gyro: Array, accel: Array, channels: NDArray[np.int_], text: str = "") -> bytes:
    """A request.

    Args:
        until_s: Time by the firmware's clock until which it runs [s].
        gyro: Body rate, (3,) [rad/s].
        accel: Specific force, (3,) [m/s²].
        channels: The first channels of the remote control, (6,) [µs].
        text: For the serial port.
    """
    message = np.zeros((), REQUEST)
    state, rc = message["state"], message["rc"]
    state["timestamp"] = rc["timestamp"] = until_s
    state["gyro"] = _whole(gyro * [1.0, -1.0, -1.0], GYRO_COUNTS)
    state["accel"] = _whole(-accel, ACCEL_COUNTS)
    state["quat"], state["pressure"] = (1.0, 0.0, 0.0, 0.0), PRESSURE
    rc["channels"] = LOW
    rc["channels"][: len(channels)] = channels
    return message.tobytes() + text.encode()


def unpack(message: bytes) -> tuple[np.void, str]:
    """A reply's record of `REPLY`, and its text.

    Raises:
        ValueError: It is too short.
    """
    if len(message) < REPLY.itemsize:
        raise ValueError(f"a reply of {len(message)} bytes is too short; it should have {REPLY.itemsize}")
    return np.frombuffer(message, REPLY, 1)[0], message[REPLY.itemsize :].decode(errors="replace")


def _whole(values: Array, counts: float) -> Array:
    """Round to counts; a quarter more, as the firmware cuts to whole numbers where a sensor rounds."""
    rounded = np.rint(values * counts)
    return (rounded + 0.25 * np.sign(rounded)) / counts


def stick(deflection: Array) -> NDArray[np.int_]:
    """Channels for deflections from −1 to 1 [µs]."""
    return np.rint(CENTRE + 500 * np.clip(deflection, -1.0, 1.0)).astype(int)


def throttle(motor: Array, idle: float) -> NDArray[np.int_]:
    """Channel at which the firmware's mixer gives all motors a command, which is at least `idle` [µs]."""
    share = np.clip((motor - idle) / (1.0 - idle), 0.02, 1.0)  # closed, it would reset its integrals
    return np.rint(THROTTLE_LOW + (HIGH - THROTTLE_LOW) * share).astype(int)
