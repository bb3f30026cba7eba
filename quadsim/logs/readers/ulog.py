"""PX4 logs (ULog), read by pyulog."""

import errno
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..recording import OWN_ESTIMATE, Array, Recording, Track, from_frd

OWN = "vehicle_attitude"
"""Topic of the autopilot's own estimate, in the axes in which the IMU is logged."""
TRUTHS = {
    "vehicle_attitude_groundtruth": "the simulator's truth",
    "vehicle_mocap_odometry": "motion capture",
    "vehicle_visual_odometry": "visual odometry or motion capture",
    OWN: f"the autopilot's {OWN_ESTIMATE}",
}
"""Topics with an attitude `q` (FRD body in NED world), the most accurate first."""
Topic = Mapping[str, Any]
"""Fields of a topic by name, (T,) each."""
IMUS = {
    "sensor_combined": ("IMU from sensor_combined", ("gyro_rad", "accelerometer_m_s2")),
    "vehicle_imu": ("IMU from the increments of vehicle_imu", ("delta_angle", "delta_velocity")),
}
"""Topics of the IMU in order of preference, each with a note and its fields."""
MAGNETOMETERS = {
    "vehicle_magnetometer": [f"magnetometer_ga[{k}]" for k in range(3)],
    "sensor_mag": ["x", "y", "z"],
}
"""Topics with the magnetic field in FRD axes [G] and their fields, the calibrated one first."""


class Bounded(io.BufferedReader):
    """A file that limits the number of bytes read, because pyulog does not stop on some damaged files."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self.path, self.left = path, 4 * path.stat().st_size + 1_000_000

    def read(self, size: int | None = -1, /) -> bytes:
        """Read bytes, up to the limit."""
        found = super().read(size)
        self.left -= len(found) + 1
        if self.left < 0:  # pyulog takes a ValueError for a damaged message, and continues
            raise OSError(errno.EIO, "damaged: no end of the log is found", str(self.path))
        return found


def read_ulog(path: Path, truth: str | None = None) -> Recording:
    """Read sensor_combined or vehicle_imu, an attitude and, if logged, rotor speeds and the magnetometer.

    Args:
        path: A .ulg file.
        truth: Topic of the true attitude; None for the first existing one of TRUTHS.
    """
    from pyulog import ULog

    log = ULog(Bounded(path))
    topics = {each.name: each.data for each in reversed(log.data_list)}  # the first instance of each
    source = next((name for name in IMUS if name in topics), None)
    if source is None:
        raise ValueError(f"{path}: neither {' nor '.join(IMUS)}; topics: {', '.join(sorted(topics))}")
    note, fields = IMUS[source]
    gyro, accel = (_columns(topics[source], [f"{field}[{k}]" for k in range(3)]) for field in fields)
    if source == "vehicle_imu":
        gyro, accel = (
            each / (_columns(topics[source], [f"{field}_dt"]) * 1e-6)
            for each, field in zip((gyro, accel), fields, strict=True)
        )
    lost = f"{len(log.dropouts)} dropouts of the logger, {sum(d.duration for d in log.dropouts)} ms"
    sensors, esc = {}, topics.get("esc_status", {})
    escs = [f"esc[{k}].esc_rpm" for k in range(int(np.max(esc.get("esc_count", 0), initial=0)))]
    if escs := [each for each in escs if each in esc]:  # in the order of PX4's outputs
        sensors["rotor_vel"] = Track(_time(esc), np.abs(_columns(esc, escs)) * (np.pi / 30))
    for topic, names in reversed(MAGNETOMETERS.items()):
        if {*names} <= {*topics.get(topic, {})}:
            sensors["mag"] = Track(_time(topics[topic]), _columns(topics[topic], names) * 1e-4)
    notes = (note, *([lost] if log.dropouts else []), *(f"{name} from the log" for name in sensors))
    time = _time(topics[source])
    found = Recording(path.name, "PX4 ULog", time, gyro, accel, notes=notes, sensors=sensors)
    chosen = truth or next((name for name in TRUTHS if name in topics), None)
    if chosen is None:
        return from_frd(found)
    if chosen not in topics:
        raise ValueError(f'{path}: no topic "{chosen}"; topics: {", ".join(sorted(topics))}')
    stamps = "timestamp_sample" if "timestamp_sample" in topics[chosen] else "timestamp"
    quat = _columns(topics[chosen], [f"q[{k}]" for k in range(4)])
    kind = f"{chosen}: {TRUTHS.get(chosen, 'as asked for')}"
    return from_frd(found.with_truth(kind, _time(topics[chosen], stamps), quat, own_axes=chosen == OWN))


def _time(topic: Topic, name: str = "timestamp") -> Array:
    return np.asarray(topic[name], np.float64) * 1e-6


def _columns(topic: Topic, names: Sequence[str]) -> Array:
    return np.stack([np.asarray(topic[name], np.float64) for name in names], axis=1)
