"""PX4 logs (ULog), through pyulog."""

import errno
import io
from pathlib import Path

import numpy as np

from .needs import needed
from .recording import Recording, from_frd, table

TRUTHS = {
    "vehicle_attitude_groundtruth": "the simulator's truth",
    "vehicle_mocap_odometry": "motion capture",
    "vehicle_visual_odometry": "visual odometry or motion capture",
    "vehicle_attitude": "the autopilot's own estimate, which is no independent truth",
}
"""Topics that hold an attitude `q` (FRD body in NED world), the best first."""


class Bounded(io.BufferedReader):
    """A file that can be read a few times over: in some damaged ones pyulog seeks back without an end."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self.path, self.left = path, 4 * path.stat().st_size + 1_000_000

    def read(self, size: int | None = -1, /) -> bytes:
        """Bytes, as long as there are any to spend."""
        found = super().read(size)
        self.left -= len(found) + 1
        if self.left < 0:  # pyulog takes a ValueError for a damaged message, and goes on
            raise OSError(errno.EIO, "damaged: no end of the log is found", str(self.path))
        return found


def read_ulog(path: Path, truth: str | None = None) -> Recording:
    """Read sensor_combined (or vehicle_imu) and the best attitude topic.

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
        gyro = table("sensor_combined", [data[f"gyro_rad[{k}]"] for k in range(3)], 3)
        accel = table("sensor_combined", [data[f"accelerometer_m_s2[{k}]"] for k in range(3)], 3)
        notes.append("IMU from sensor_combined")
    elif "vehicle_imu" in topics:
        data = topics["vehicle_imu"]
        dt = np.asarray(data["delta_angle_dt"], np.float64)[:, None] * 1e-6
        dv = np.asarray(data["delta_velocity_dt"], np.float64)[:, None] * 1e-6
        gyro = table("vehicle_imu", [data[f"delta_angle[{k}]"] for k in range(3)], 3) / dt
        accel = table("vehicle_imu", [data[f"delta_velocity[{k}]"] for k in range(3)], 3) / dv
        notes.append("IMU from the increments of vehicle_imu")
    else:
        raise ValueError(
            f"{path}: neither sensor_combined nor vehicle_imu; topics: {', '.join(sorted(topics))}"
        )
    if log.dropouts:
        notes.append(
            f"{len(log.dropouts)} dropouts of the logger, {sum(d.duration for d in log.dropouts)} ms"
        )
    recorded = Recording(
        path.name,
        "PX4 ULog",
        np.asarray(data["timestamp"], np.float64) * 1e-6,
        gyro,
        accel,
        notes=tuple(notes),
    )
    chosen = truth or next((name for name in TRUTHS if name in topics), None)
    if chosen is None:
        return from_frd(recorded)
    if chosen not in topics:
        raise ValueError(f'{path}: no topic "{chosen}"; topics: {", ".join(sorted(topics))}')
    found = topics[chosen]
    stamps = found.get("timestamp_sample", found["timestamp"])
    quat = table(chosen, [found[f"q[{k}]"] for k in range(4)], 4)
    return from_frd(
        Recording(
            recorded.name, recorded.format, recorded.time, gyro, accel,
            truth=f"{chosen}: {TRUTHS.get(chosen, 'as asked for')}",
            truth_time=np.asarray(stamps, np.float64) * 1e-6,
            quat=quat, notes=recorded.notes,
        )
    )  # fmt: skip
