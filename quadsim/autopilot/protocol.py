"""Messages between the simulator and Betaflight's SITL, exchanged by `assets/autopilot/lockstep.c`.

A request contains two packets defined in the firmware's `target.h`, the simulated state and the channels of
the remote control, and text for the first serial port. A reply contains the motor packet, the attitude
estimate, whether the firmware is armed, and the text that the firmware wrote to that port.
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
"""Channels, 1000 to 2000 µs: roll, pitch, throttle, yaw, arm switch, mode switch; the others are not used."""
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
"""Upper bound of the size of a message [bytes]."""

GYRO_COUNTS = 16.4 * 180.0 / np.pi
"""Counts of the firmware's gyroscope per rad/s: 2000 °/s are 32 800 counts."""
ACCEL_COUNTS = 256 / 9.80665
"""Counts of the firmware's accelerometer per m/s²."""
PRESSURE = 101325.0
CENTRE, LOW, HIGH = 1500, 1000, 2000
"""Channel values of a stick in the centre, at its lower end and at its upper end [µs]."""
THROTTLE_LOW = 1050
"""`min_check` of the firmware: channel value below which the throttle counts as closed [µs]."""


def pack(until_s: float, gyro: Array, accel: Array, channels: NDArray[np.int_], text: str = "") -> bytes:
    """Encode a request.

    Args:
        until_s: Time at which the firmware stops and replies, by its own clock [s].
        gyro: Body rate, (3,) [rad/s].
        accel: Specific force, (3,) [m/s²].
        channels: The first channels of the remote control, (6,) [µs].
        text: Text for the serial port.
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
    """Decode a reply; return its record of `REPLY` and its text.

    Raises:
        ValueError: The reply is too short.
    """
    if len(message) < REPLY.itemsize:
        raise ValueError(f"a reply of {len(message)} bytes is too short; it should have {REPLY.itemsize}")
    return np.frombuffer(message, REPLY, 1)[0], message[REPLY.itemsize :].decode(errors="replace")


def _whole(values: Array, counts: float) -> Array:
    """Round to counts and add a quarter, because the firmware truncates where a sensor rounds."""
    rounded = np.rint(values * counts)
    return (rounded + 0.25 * np.sign(rounded)) / counts


def stick(deflection: Array) -> NDArray[np.int_]:
    """Convert stick deflections from −1 to 1 to channel values [µs]."""
    return np.rint(CENTRE + 500 * np.clip(deflection, -1.0, 1.0)).astype(int)


def throttle(motor: Array, idle: float) -> NDArray[np.int_]:
    """Return the throttle channel at which the mixer gives all motors this command, at least `idle` [µs]."""
    share = np.clip((motor - idle) / (1.0 - idle), 0.02, 1.0)  # closed, it would reset its integrals
    return np.rint(THROTTLE_LOW + (HIGH - THROTTLE_LOW) * share).astype(int)
