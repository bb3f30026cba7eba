"""Logs of the Crazyflie's uSD card deck, versions 1 and 2 of its format.

Layout (bitcraze.io, "uSD-card deck"), little-endian: 0xBC, version, number of event types; of each type its
number, name and variables as "group.name(t)" with t a code of `struct`; then events, each the number of its
type, a stamp (version 1: uint32 [ms], version 2: uint64 [µs]) and the values; last the CRC-32 of all before.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from zlib import crc32

import numpy as np

from ..cleaning import GAP
from ..recording import OWN_ESTIMATE, Array, Recording, Track
from ..resample import interpolated

MAGIC = 0xBC
STAMPS = {1: ("<HI", 1e-3), 2: ("<HQ", 1e-6)}
"""Version to the layout of an event's head and its unit of time [s]."""
GYRO = ("gyro.x", "gyro.y", "gyro.z")
ACCEL = ("acc.x", "acc.y", "acc.z")
ROTORS = ("rpm.m1", "rpm.m2", "rpm.m3", "rpm.m4")
TRUTHS = {
    "locSrv": "motion capture",
    "stateEstimate": f"the autopilot's {OWN_ESTIMATE}",
}
"""Groups that hold an attitude qw, qx, qy, qz (FLU body in a world with z up), the best first."""


@dataclass
class Event:
    """One type of event, and what was logged of it."""

    names: tuple[str, ...]
    layout: struct.Struct
    stamps: list[int] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)


def is_usdlog(path: Path) -> bool:
    """Whether a file begins as such a log; the deck gives its files no suffix."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        head = stream.read(3)
    return len(head) == 3 and head[0] == MAGIC and int.from_bytes(head[1:], "little") < 256


def read_usdlog(path: Path) -> Recording:
    """Read gyroscope [deg/s], accelerometer [g], and attitude, position and rotor speeds [rpm] where logged.

    Args:
        path: A file of the deck, such as log00.

    Raises:
        ValueError: Not such a log, an unknown version, a damaged header, or no gyroscope and accelerometer.
    """
    tracks, notes = decode(path)
    imu = _track(tracks, GYRO + ACCEL)
    gyro, accel = _track(tracks, GYRO), _track(tracks, ACCEL)
    if imu is None and gyro is not None and accel is not None:
        both = (gyro.time >= accel.time[0]) & (gyro.time <= accel.time[-1])
        if not both.any():
            raise ValueError(f"{path}: gyroscope and accelerometer were logged at different times")
        time = gyro.time[both]
        longest_s = GAP * float(np.median(np.diff(accel.time)))
        imu = Track(time, np.hstack([gyro.values[both], interpolated(time, *accel, longest_s)]))
        events = " and ".join(next(n for n, v in tracks.items() if s[0] in v) for s in (GYRO, ACCEL))
        notes = (*notes, f"{events}: accelerometer brought to the stamps of the gyroscope")
    if imu is None:
        names = sorted({name for values in tracks.values() for name in values if name != "time"})
        raise ValueError(
            f"{path}: no event has all of {', '.join(GYRO + ACCEL)}; logged: {', '.join(names) or 'nothing'}"
        )
    sensors = {}
    if (rotors := _track(tracks, ROTORS)) is not None:
        sensors["rotor_vel"] = Track(rotors.time, np.abs(rotors.values) * (np.pi / 30))
        notes = (*notes, "rotor_vel from the log")
    log = Recording(
        path.name, "Crazyflie uSD log", imu.time, np.deg2rad(imu.values[:, :3]), imu.values[:, 3:] * 9.80665,
        notes=notes, sensors=sensors,
    )  # fmt: skip
    for group, kind in TRUTHS.items():
        orientation = tuple(f"{group}.{name}" for name in ("qw", "qx", "qy", "qz"))
        pose = _track(tracks, orientation + tuple(f"{group}.{name}" for name in "xyz"))
        found = pose or _track(tracks, orientation)
        if found is not None:
            position = None if pose is None else pose.values[:, 4:]
            own = group == "stateEstimate"
            return log.with_truth(f"{group}: {kind}", found.time, found.values[:, :4], position, own)
    return log


def decode(path: Path) -> tuple[dict[str, dict[str, Array]], tuple[str, ...]]:
    """Name of an event to its variables (K,) and its `time` (K,) [s], and what is wrong with the file.

    Raises:
        ValueError: Not such a log, an unknown version, or a damaged header.
    """
    data = path.read_bytes()
    if len(data) < 5 or data[0] != MAGIC:
        raise ValueError(f"{path}: not a log of the Crazyflie's uSD deck: it does not begin with 0xBC")
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in STAMPS:
        raise ValueError(f"{path}: version {version} of the uSD log; 1 and 2 can be read")
    try:
        names, events, at = _header(data, count)
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
        event.stamps.append(stamp)
        event.rows.append(event.layout.unpack_from(data, at + head.size))
        at += head.size + event.layout.size
    tracks = {
        names[number]: dict(zip(event.names, np.array(event.rows, np.float64).T, strict=True))
        | {"time": np.array(event.stamps, np.float64) * unit}
        for number, event in events.items()
        if event.rows
    }
    if whole and at == end:
        return tracks, ()
    return tracks, (f"damaged: bad checksum, read up to byte {at} of {len(data)}",)


def _header(data: bytes, count: int) -> tuple[dict[int, str], dict[int, Event], int]:
    """Names and types of the events by their number, and where the first event begins."""
    names, events, at = {}, {}, 5
    for _ in range(count):
        (number,) = struct.unpack_from("<H", data, at)
        names[number], at = _text(data, at + 2)
        (size,) = struct.unpack_from("<H", data, at)
        at += 2
        variables = []
        for _ in range(size):
            text, at = _text(data, at)
            if len(text) < 4 or text[-3] != "(" or text[-2] not in "bBhHiIqQefd":
                raise ValueError(text)
            variables.append((text[:-3], text[-2]))
        layout = struct.Struct("<" + "".join(code for _, code in variables))
        events[number] = Event(tuple(name for name, _ in variables), layout)
    return names, events, at


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(0, at)
    text = data[at:end].decode()
    if not text.isprintable():
        raise ValueError(text)
    return text, end + 1


def _track(tracks: Mapping[str, Mapping[str, Array]], names: tuple[str, ...]) -> Track | None:
    """Variables of the event that logged all of them most often."""
    found = [values for values in tracks.values() if all(name in values for name in names)]
    if not found:
        return None
    best = max(found, key=lambda values: values["time"].size)
    return Track(best["time"], np.stack([best[name] for name in names], axis=1))
