"""PX4 logs (ULog), through pyulog."""

import errno
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..recording import Array, Recording, Track, from_frd, table
from .needs import needed

OWN = "vehicle_attitude"
"""The autopilot's estimate: it is of the axes in which the IMU is logged."""
TRUTHS = {
    "vehicle_attitude_groundtruth": "the simulator's truth",
    "vehicle_mocap_odometry": "motion capture",
    "vehicle_visual_odometry": "visual odometry or motion capture",
    OWN: "the autopilot's own estimate, which is no independent truth",
}
"""Topics that hold an attitude `q` (FRD body in NED world), the best first."""


MAGNETOMETERS = {
    "vehicle_magnetometer": [f"magnetometer_ga[{k}]" for k in range(3)],
    "sensor_mag": ["x", "y", "z"],
}
"""Topics that hold the magnetic field in FRD axes [G] and their fields, the calibrated one first."""


class Bounded(io.BufferedReader):
    """A file that can be read a few times over: in some damaged ones pyulog seeks back without an end."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self.path, self.left = path, 4 * path.stat().st_size + 1_000_000

    def read(self, size: int | None = -1, /) -> bytes:
        """Bytes, as long as there are any to spend."""
        found = super().read(size)
        self.left -= len(found) + 1
        if self.left < 0:  # pyulog takes a ValueError for a damaged message, and continues
            raise OSError(errno.EIO, "damaged: no end of the log is found", str(self.path))
        return found


def read_ulog(path: Path, truth: str | None = None) -> Recording:
    """Read sensor_combined (or vehicle_imu), the best attitude topic, and ESCs and magnetometer if there are.

    Args:
        path: A .ulg file.
        truth: Topic to take for the true attitude; None for the first of TRUTHS that is there.
    """
    ulog = needed("pyulog", "logs").ULog
    log = ulog(Bounded(path))
    topics = {each.name: each.data for each in reversed(log.data_list)}  # the first instance of each
    notes = []
    if "sensor_combined" in topics:
        data = topics["sensor_combined"]
        gyro = table("sensor_combined", [data[f"gyro_rad[{k}]"] for k in range(3)])
        accel = table("sensor_combined", [data[f"accelerometer_m_s2[{k}]"] for k in range(3)])
        notes.append("IMU from sensor_combined")
    elif "vehicle_imu" in topics:
        data = topics["vehicle_imu"]
        dt = np.asarray(data["delta_angle_dt"], np.float64)[:, None] * 1e-6
        dv = np.asarray(data["delta_velocity_dt"], np.float64)[:, None] * 1e-6
        gyro = table("vehicle_imu", [data[f"delta_angle[{k}]"] for k in range(3)]) / dt
        accel = table("vehicle_imu", [data[f"delta_velocity[{k}]"] for k in range(3)]) / dv
        notes.append("IMU from the increments of vehicle_imu")
    else:
        raise ValueError(
            f"{path}: neither sensor_combined nor vehicle_imu; topics: {', '.join(sorted(topics))}"
        )
    if log.dropouts:
        notes.append(
            f"{len(log.dropouts)} dropouts of the logger, {sum(d.duration for d in log.dropouts)} ms"
        )
    sensors = _sensors(topics)
    recorded = Recording(
        path.name, "PX4 ULog", _seconds(data["timestamp"]), gyro, accel,
        notes=(*notes, *(f"{name} from the log" for name in sensors)), sensors=sensors,
    )  # fmt: skip
    chosen = truth or next((name for name in TRUTHS if name in topics), None)
    if chosen is None:
        return from_frd(recorded)
    if chosen not in topics:
        raise ValueError(f'{path}: no topic "{chosen}"; topics: {", ".join(sorted(topics))}')
    found = topics[chosen]
    stamps = found.get("timestamp_sample", found["timestamp"])
    quat = table(chosen, [found[f"q[{k}]"] for k in range(4)])
    return from_frd(
        replace(
            recorded,
            truth=f"{chosen}: {TRUTHS.get(chosen, 'as asked for')}",
            truth_time=_seconds(stamps),
            quat=quat,
            truth_axes="imu" if chosen == OWN else "body",
        )
    )


def _seconds(stamps: ArrayLike) -> Array:
    return np.asarray(stamps, np.float64) * 1e-6


def _sensors(topics: Mapping[str, Mapping[str, Any]]) -> dict[str, Track]:
    """Rotor speeds and magnetic field, where the log has them; the rotors in the order of PX4's outputs."""
    found = {}
    if "esc_status" in topics:
        esc = topics["esc_status"]
        count = int(np.max(esc.get("esc_count", 0), initial=0))
        rpm = [esc[field] for k in range(count) if (field := f"esc[{k}].esc_rpm") in esc]
        if rpm:
            speeds = np.abs(table("esc_status", rpm)) * (np.pi / 30)
            found["rotor_vel"] = Track(_seconds(esc["timestamp"]), speeds)
    for topic, fields in MAGNETOMETERS.items():
        data = topics.get(topic, {})
        if "mag" not in found and all(field in data for field in fields):
            gauss = table(topic, [data[field] for field in fields])
            found["mag"] = Track(_seconds(data["timestamp"]), gauss * 1e-4)
    return found
