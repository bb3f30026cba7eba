"""ArduPilot's DataFlash logs (.bin): FRD body axes in an NED world.

The layout (ArduPilot, libraries/AP_Logger/LogStructure.h) is little-endian. A message consists of 0xA3, 0x95,
a type and values. Messages of type 128, FMT, define the other types: length, name, and codes and names of the
values.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...rotation import quat_from_euler
from ...runs.compiled import njit
from ..recording import OWN_ESTIMATE, Array, Recording, Track, from_frd

FMT = 128
CODES = {
    **{"b": "i1", "B": "u1", "M": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "q": "i8", "Q": "u8"},
    **{"c": "i2", "C": "u2", "e": "i4", "E": "u4", "L": "i4", "g": "f2", "f": "f4", "d": "f8"},
    **{"n": "S4", "N": "S16", "Z": "S64", "a": "S64"},
}
"""NumPy type for each value code. The codes c, C, e and E are hundredths and are not used here."""
LAYOUT = np.dtype(
    [("head", "S3"), ("type", "u1"), ("length", "u1"), ("name", "S4"), ("codes", "S16"), ("names", "S64")]
)
"""Layout of a message of type FMT."""
WANTED = ("IMU", "SIM", "ATT", "MAG", "ESC")


def read_dataflash(path: Path) -> Recording:
    """Read the first IMU, the attitude and, if logged, rotor speeds from ESCs and the magnetometer.

    The attitude is that of the message SIM, from a simulator, or else that of ATT, the autopilot's estimate.

    Args:
        path: A .bin file.

    Raises:
        ValueError: The file is not a DataFlash log, or the log has no IMU.
    """
    found, skipped = _decoded(np.frombuffer(path.read_bytes(), np.uint8))
    if "TimeUS" not in found.get("IMU", ()):
        there = ", ".join(sorted(found)) or "none"
        raise ValueError(f"{path}: no IMU with TimeUS in this log; messages: {there}")
    imu, sensors = _first(found["IMU"]), {}
    if {"Instance", "RPM"} <= {
        *found.get("ESC", ())
    }:  # rotors in the order of the ESCs, as the first is read
        escs = [each for _, each in found["ESC"].groupby("Instance")]
        time = _time(escs[0])
        speeds = [np.interp(time, _time(each), each["RPM"] * (np.pi / 30)) for each in escs]
        sensors["rotor_vel"] = Track(time, np.abs(np.stack(speeds, axis=1)))
    if len(found.get("MAG", ())):
        mag = _first(found["MAG"])
        sensors["mag"] = Track(_time(mag), _columns(mag, "MagX", "MagY", "MagZ") * 1e-7)
    damage = [f"damaged: {skipped} bytes are of no message"] if skipped else []
    notes = ("IMU from IMU, the first of them", *damage, *(f"{name} from the log" for name in sensors))
    gyro, accel = (_columns(imu, *(f"{name}{axis}" for axis in "XYZ")) for name in ("Gyr", "Acc"))
    log = Recording(path.name, "ArduPilot log", _time(imu), gyro, accel, notes=notes, sensors=sensors)
    if "Q1" in found.get("SIM", ()):
        quat = _columns(found["SIM"], "Q1", "Q2", "Q3", "Q4")
        log = log.with_truth("SIM: the simulator's truth", _time(found["SIM"]), quat)
    elif len(found.get("ATT", ())):
        quat = quat_from_euler(*np.radians(_columns(found["ATT"], "Roll", "Pitch", "Yaw")).T)
        own = f"ATT: the autopilot's {OWN_ESTIMATE}"
        log = log.with_truth(own, _time(found["ATT"]), quat, own_axes=True)
    return from_frd(log)


def _decoded(content: NDArray[np.uint8]) -> tuple[dict[str, pd.DataFrame], int]:
    """Decode messages by type; return messages and the number of bytes outside messages."""
    found = {}
    starts, skipped = _starts(content)
    kinds = content[starts + 2]
    for made in _rows(content, starts[kinds == FMT], LAYOUT):
        begins, name = starts[kinds == made["type"]], made["name"].decode("latin-1")
        if not begins.size or made["type"] == FMT:
            continue
        codes, names = made["codes"].decode("latin-1"), made["names"].decode("latin-1").split(",")
        found[name] = pd.DataFrame()
        if name in WANTED and len({*names}) == len(names) == len(codes) and {*codes} <= {*CODES}:
            fields = [(each, f"<{CODES[code]}") for each, code in zip(names, codes, strict=True)]
            layout = np.dtype([("head", "S3"), *fields])
            if layout.itemsize == made["length"]:
                found[name] = pd.DataFrame(_rows(content, begins, layout))
    return found, skipped


@njit(cache=True)
def _starts(content):
    """Return where messages begin in bytes (N,), (M,), and the number of bytes outside messages."""
    starts, lengths = np.empty(content.size // 3 + 1, np.int64), np.zeros(256, np.int64)
    lengths[FMT] = 89
    at, count, skipped = 0, 0, 0
    while at + 3 <= content.size:
        kind = content[at + 2]
        length = lengths[kind] if content[at] == 0xA3 and content[at + 1] == 0x95 else 0
        if length < 3 or at + length > content.size:
            at, skipped = at + 1, skipped + 1
            continue
        if kind == FMT and content[at + 3] != FMT:
            lengths[content[at + 3]] = content[at + 4]
        starts[count] = at
        at, count = at + length, count + 1
    return starts[:count], skipped + content.size - at


def _rows(
    content: NDArray[np.uint8], starts: NDArray[np.int64], layout: np.dtype[np.void]
) -> NDArray[np.void]:
    """Return messages that begin at bytes (M,) of a log, as (M,) records of their layout."""
    return content[starts[:, None] + np.arange(layout.itemsize)].view(layout)[:, 0]


def _first(messages: pd.DataFrame) -> pd.DataFrame:
    """Return messages of the first sensor of a kind.

    Older logs name other sensors in the type, such as IMU2.
    """
    instance = next((name for name in ("I", "Instance") if name in messages), None)
    return messages if instance is None else messages.loc[messages[instance] == messages[instance].min()]


def _time(messages: pd.DataFrame) -> Array:
    return messages["TimeUS"].to_numpy() * 1e-6


def _columns(messages: pd.DataFrame, *names: str) -> Array:
    return messages[[*names]].to_numpy(np.float64)
