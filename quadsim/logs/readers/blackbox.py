"""Betaflight's blackbox logs (.bbl, .bfl) in FLU body axes, decoded by `blackbox_decode` of blackbox-tools.

Betaflight's axes equal those of quadsim (src/main/flight/imu.c): a level accelerometer reads +1 g on z, and
positive rates roll right, pitch the nose down and yaw left. The header of a log contains the scales
(src/main/blackbox/blackbox.c).
"""

import re
import shutil
import struct
import subprocess
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd

from ..recording import OWN_ESTIMATE, Array, Recording, Track

PROGRAM = "blackbox_decode"
START = b"H Product:Blackbox flight data recorder"
"""First bytes of each log in a file. A log is written each time the vehicle is armed."""
G = 9.80665
HIGH_RESOLUTION = 10.0
"""Factor of the rates if the header has blackbox_high_resolution."""
QUAT_SCALE = 32767.0


def read_blackbox(path: Path) -> Recording:
    """Read gyroADC, accSmooth and, if logged, imuQuaternion and eRPM of the longest log in a file.

    Args:
        path: A .bbl or .bfl file.

    Raises:
        ValueError: `blackbox_decode` is not installed or does not decode the file, or a column is missing.
    """
    logs = path.read_bytes().split(START)[1:]
    if not logs:
        raise ValueError(f"{path}: not a blackbox log: no header")
    longest = max(range(len(logs)), key=lambda k: len(logs[k]))
    header = dict(re.findall(r"^H ([^:\n]+):([^\n]*)$", logs[longest].decode("latin-1"), re.MULTILINE))
    table = _decoded(path, longest + 1)

    def columns(name: str, count: int) -> Array:
        wanted = [f"{name}[{k}]" for k in range(count)]
        if missing := [each for each in wanted if each not in table]:
            raise ValueError(f"{path}: no {missing[0]} in this log; columns: {', '.join(table)}")
        return table[wanted].to_numpy(np.float64)

    time = table["time"].to_numpy(np.float64) * 1e-6
    fine = HIGH_RESOLUTION if int(header.get("blackbox_high_resolution", "0")) else 1.0
    (scale,) = struct.unpack("<f", struct.pack("<I", int(header.get("gyro_scale", "0x3f800000"), 16)))
    gyro = np.radians(columns("gyroADC", 3) * (scale / fine))
    accel = columns("accSmooth", 3) * (G / float(header.get("acc_1G", "2048")))
    notes, sensors = [f"log {longest + 1} of {len(logs)}, the longest"] if len(logs) > 1 else [], {}
    if (rotors := sum(re.fullmatch(r"eRPM\[\d\]", each) is not None for each in table)) > 0:
        poles = float(header.get("motor_poles", "14"))
        sensors["rotor_vel"] = Track(time, columns("eRPM", rotors) * (100.0 * 2.0 / poles * np.pi / 30))
        notes.append(f"rotor_vel from the log, with {poles:g} poles of a motor")
    log = Recording(path.name, "Betaflight blackbox", time, gyro, accel, notes=tuple(notes), sensors=sensors)
    if "imuQuaternion[0]" not in table:
        return log
    xyz = columns("imuQuaternion", 3) / QUAT_SCALE  # w is positive
    quat = np.column_stack([np.sqrt(np.maximum(1.0 - (xyz**2).sum(axis=1), 0.0)), xyz])
    return log.with_truth(f"imuQuaternion: the autopilot's {OWN_ESTIMATE}", time, quat, own_axes=True)


def _decoded(path: Path, number: int) -> pd.DataFrame:
    """Return the frames of one log of a file, counted from 1, in recorded units."""
    program = shutil.which(PROGRAM)
    if program is None:
        raise ValueError(
            f"{path}: reading it needs the program {PROGRAM} of Betaflight's blackbox-tools on PATH"
        )
    command = [program, "--stdout", "--index", str(number), str(path.resolve())]
    done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, check=False)
    said = (done.stderr.decode("utf-8", "replace").strip().splitlines() or ["no reason given"])[-1]
    if done.returncode != 0 or not done.stdout.strip():
        raise ValueError(f"{path}: {PROGRAM} cannot decode it: {said}")
    table = pd.read_csv(BytesIO(done.stdout), skipinitialspace=True, low_memory=False)
    return table.rename(columns=lambda name: re.sub(r" *\(.*\)", "", name).strip())
