"""Logs of the Crazyflie's uSD card deck, in versions 1 and 2 of the format.

The layout (bitcraze.io, "uSD-card deck") is little-endian. The header contains 0xBC, the version and the
number of event types, and for each type its number, name and variables as "group.name(t)", where t is a code
of `struct`. Each event contains the number of its type, a stamp (version 1: uint32 [ms], version 2: uint64
[µs]) and values. The file ends with the CRC-32 of all preceding bytes.
"""

import struct
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np

from ..recording import OWN_ESTIMATE, Recording, Track
from ..resample import interpolated
from ..thresholds import CLEAN

MAGIC = 0xBC
STAMPS = {1: ("<HI", 1e-3), 2: ("<HQ", 1e-6)}
"""For each version, the layout of an event's header and the unit of time [s]."""
GYRO = ("gyro.x", "gyro.y", "gyro.z")
ACCEL = ("acc.x", "acc.y", "acc.z")
ROTORS = ("rpm.m1", "rpm.m2", "rpm.m3", "rpm.m4")
TRUTHS = {
    "locSrv": "motion capture",
    "stateEstimate": f"the autopilot's {OWN_ESTIMATE}",
}
"""Groups with an attitude qw, qx, qy, qz (FLU body in a world with z up), the most accurate first."""


class Event(NamedTuple):
    """One type of event and its logged data: a stamp and values in each row."""

    name: str
    variables: list[str]
    layout: struct.Struct
    rows: list[tuple[float, ...]]


def is_usdlog(path: Path) -> bool:
    """Return whether a file starts like a log of the deck, whose files have no suffix."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        head = stream.read(3)
    return len(head) == 3 and head[0] == MAGIC and int.from_bytes(head[1:], "little") < 256


def read_usdlog(path: Path) -> Recording:
    """Read gyroscope [deg/s], accelerometer [g] and, if logged, attitude, position and rotor speeds [rpm].

    Args:
        path: A file of the deck, such as log00.

    Raises:
        ValueError: The file is not a log of the deck, has an unknown version or a damaged header, or lacks
            gyroscope or accelerometer.
    """
    events, notes = decode(path)
    imu = _track(events, GYRO + ACCEL)
    gyro, accel = _track(events, GYRO), _track(events, ACCEL)
    if imu is None and gyro is not None and accel is not None:
        both = (gyro.time >= accel.time[0]) & (gyro.time <= accel.time[-1])
        if not both.any():
            raise ValueError(f"{path}: gyroscope and accelerometer were logged at different times")
        time, longest_s = gyro.time[both], CLEAN.gap * float(np.median(np.diff(accel.time)))
        imu = Track(time, np.hstack([gyro.values[both], interpolated(time, *accel, longest_s)]))
        names = " and ".join(next(e.name for e in events if s[0] in e.variables) for s in (GYRO, ACCEL))
        notes += (f"{names}: accelerometer brought to the stamps of the gyroscope",)
    if imu is None:
        logged = ", ".join(sorted({name for event in events for name in event.variables})) or "nothing"
        raise ValueError(f"{path}: no event has all of {', '.join(GYRO + ACCEL)}; logged: {logged}")
    sensors = {}
    if (rotors := _track(events, ROTORS)) is not None:
        sensors["rotor_vel"] = Track(rotors.time, np.abs(rotors.values) * (np.pi / 30))
        notes += ("rotor_vel from the log",)
    gyro, accel = np.deg2rad(imu.values[:, :3]), imu.values[:, 3:] * 9.80665
    log = Recording(path.name, "Crazyflie uSD log", imu.time, gyro, accel, notes=notes, sensors=sensors)
    for group, kind in TRUTHS.items():
        names = tuple(f"{group}.{name}" for name in ("qw", "qx", "qy", "qz", "x", "y", "z"))
        found = _track(events, names) or _track(events, names[:4])
        if found is not None:
            position = found.values[:, 4:] if found.values.shape[1] == 7 else None
            own = group == "stateEstimate"
            return log.with_truth(f"{group}: {kind}", found.time, found.values[:, :4], position, own)
    return log


def decode(path: Path) -> tuple[list[Event], tuple[str, ...]]:
    """Return event types with logged data, and a description of damage to the file.

    Raises:
        ValueError: The file is not a log of the deck, or has an unknown version or a damaged header.
    """
    data = path.read_bytes()
    if len(data) < 5 or data[0] != MAGIC:
        raise ValueError(f"{path}: not a log of the Crazyflie's uSD deck: it does not begin with 0xBC")
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in STAMPS:
        raise ValueError(f"{path}: version {version} of the uSD log; 1 and 2 can be read")
    try:
        events, at = _header(data, count)
    except (struct.error, ValueError) as error:
        raise ValueError(f"{path}: the header of the uSD log is cut off or damaged") from error
    whole = len(data) - 4 > at and crc32(data[:-4]) == int.from_bytes(data[-4:], "little")
    end = len(data) - 4 if whole else len(data)
    head, unit = struct.Struct(STAMPS[version][0]), STAMPS[version][1]
    while at + head.size <= end:
        number, stamp = head.unpack_from(data, at)
        event = events.get(number)
        if event is None or at + head.size + event.layout.size > end:
            break
        event.rows.append((stamp * unit, *event.layout.unpack_from(data, at + head.size)))
        at += head.size + event.layout.size
    damage = f"damaged: bad checksum, read up to byte {at} of {len(data)}"
    return [event for event in events.values() if event.rows], () if whole and at == end else (damage,)


def _header(data: bytes, count: int) -> tuple[dict[int, Event], int]:
    """Return event types by number, and the offset of the first event."""
    events, at = {}, 5
    for _ in range(count):
        (number,) = struct.unpack_from("<H", data, at)
        name, at = _text(data, at + 2)
        (size,) = struct.unpack_from("<H", data, at)
        at += 2
        variables, codes = [], "<"
        for _ in range(size):
            text, at = _text(data, at)
            if len(text) < 4 or text[-3] != "(" or text[-2] not in "bBhHiIqQefd":
                raise ValueError(text)
            variables.append(text[:-3])
            codes += text[-2]
        events[number] = Event(name, variables, struct.Struct(codes), [])
    return events, at


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(0, at)
    text = data[at:end].decode()
    if not text.isprintable():
        raise ValueError(text)
    return text, end + 1


def _track(events: list[Event], names: tuple[str, ...]) -> Track | None:
    """Return variables of the event type that contains all of them and was logged most often."""
    found = [event for event in events if {*names} <= {*event.variables}]
    if not found:
        return None
    best = max(found, key=lambda event: len(event.rows))
    values = np.array(best.rows, np.float64)
    return Track(values[:, 0], values[:, [1 + best.variables.index(name) for name in names]])
