"""PX4 logs (ULog), through pyulog."""

import errno
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..recording import OWN_ESTIMATE, Array, Recording, Track, from_frd

OWN = "vehicle_attitude"
"""The autopilot's estimate: it is of the axes in which the IMU is logged."""
TRUTHS = {
    "vehicle_attitude_groundtruth": "the simulator's truth",
    "vehicle_mocap_odometry": "motion capture",
    "vehicle_visual_odometry": "visual odometry or motion capture",
    OWN: f"the autopilot's {OWN_ESTIMATE}",
}
"""Topics that hold an attitude `q` (FRD body in NED world), the best first."""
Topics = Mapping[str, Mapping[str, Any]]
"""Topic to its fields."""
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
    from pyulog import ULog

    log = ULog(Bounded(path))
    topics = {each.name: each.data for each in reversed(log.data_list)}  # the first instance of each
    if "sensor_combined" in topics:
        source, note = "sensor_combined", "IMU from sensor_combined"
        gyro = _columns(topics, source, "gyro_rad", 3)
        accel = _columns(topics, source, "accelerometer_m_s2", 3)
    elif "vehicle_imu" in topics:
        source, note = "vehicle_imu", "IMU from the increments of vehicle_imu"
        gyro, accel = (
            _columns(topics, source, name, 3) / _seconds(topics[source][f"{name}_dt"])[:, None]
            for name in ("delta_angle", "delta_velocity")
        )
    else:
        text = "neither sensor_combined nor vehicle_imu; topics: "
        raise ValueError(f"{path}: {text}{', '.join(sorted(topics))}")
    lost = f"{len(log.dropouts)} dropouts of the logger, {sum(d.duration for d in log.dropouts)} ms"
    sensors = _sensors(topics)
    notes = (note, *([lost] if log.dropouts else []), *(f"{name} from the log" for name in sensors))
    time = _seconds(topics[source]["timestamp"])
    found = Recording(path.name, "PX4 ULog", time, gyro, accel, notes=notes, sensors=sensors)
    chosen = truth or next((name for name in TRUTHS if name in topics), None)
    if chosen is None:
        return from_frd(found)
    if chosen not in topics:
        raise ValueError(f'{path}: no topic "{chosen}"; topics: {", ".join(sorted(topics))}')
    stamps = topics[chosen].get("timestamp_sample", topics[chosen]["timestamp"])
    kind, quat = f"{chosen}: {TRUTHS.get(chosen, 'as asked for')}", _columns(topics, chosen, "q", 4)
    return from_frd(found.with_truth(kind, _seconds(stamps), quat, own_axes=chosen == OWN))


def _seconds(stamps: ArrayLike) -> Array:
    return np.asarray(stamps, np.float64) * 1e-6


def _columns(topics: Topics, topic: str, name: str, count: int) -> Array:
    """A field of a topic with several values, (T, count)."""
    return np.stack([np.asarray(topics[topic][f"{name}[{k}]"], np.float64) for k in range(count)], axis=1)


def _sensors(topics: Topics) -> dict[str, Track]:
    """Rotor speeds and magnetic field, where the log has them; the rotors in the order of PX4's outputs."""
    found = {}
    esc = topics.get("esc_status", {})
    count = int(np.max(esc.get("esc_count", 0), initial=0))
    rpm = [esc[field] for k in range(count) if (field := f"esc[{k}].esc_rpm") in esc]
    if rpm:
        speeds = np.abs(np.stack(rpm, axis=1).astype(np.float64)) * (np.pi / 30)
        found["rotor_vel"] = Track(_seconds(esc["timestamp"]), speeds)
    for topic, fields in MAGNETOMETERS.items():
        data = topics.get(topic, {})
        if "mag" not in found and all(field in data for field in fields):
            gauss = np.stack([np.asarray(data[field], np.float64) for field in fields], axis=1)
            found["mag"] = Track(_seconds(data["timestamp"]), gauss * 1e-4)
    return found
