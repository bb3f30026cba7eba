"""Flight logs of other tools, in the layout of the simulator's datasets."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import xarray as xr

from .cleaning import split_at_gaps
from .log_report import LogReport
from .readers.blackbox import read_blackbox
from .readers.broad import read_broad
from .readers.dataflash import read_dataflash
from .readers.euroc import euroc_folder, read_euroc
from .readers.rosbag import read_rosbag
from .readers.table import read_table
from .readers.ulog import read_ulog
from .readers.usdlog import is_usdlog, read_usdlog
from .recording import Recording, mount_matrix, mounted
from .resample import resample

__all__ = [
    "LogReport",
    "Recording",
    "read_log",
    "read_parts",
    "read_recording",
    "refused",
]

FORMATS = (
    ".ulg (PX4), .bin (ArduPilot), .bbl or .bfl (Betaflight), an EuRoC folder, .hdf5, .mat or .npz (BROAD), "
    ".bag, .db3, .mcap or a bag's folder (ROS, Foxglove), a file of the Crazyflie's uSD deck, or .toml (the "
    "column map of a CSV)"
)

BY_SUFFIX = {
    **dict.fromkeys((".hdf5", ".h5", ".mat", ".npz"), read_broad),
    **dict.fromkeys((".bbl", ".bfl"), read_blackbox),
    ".bin": read_dataflash,
    ".toml": read_table,
}
"""Readers of formats without topics."""


def read_log(
    path: str | Path,
    rate_hz: float = 200.0,
    *,
    mount: str | None = None,
    truth: str | None = None,
    imu: str | None = None,
) -> xr.Dataset:
    """Read one log of any known format.

    Args:
        path: The log.
        rate_hz: Samples per second of the result.
        mount: Rotation from IMU to body axes, for an IMU that is mounted in another way: see `mount_matrix`.
        truth: Topic or folder of the true attitude; None for the most accurate one in the log.
        imu: Topic of the IMU in a ROS bag or MCAP; None for the one with the most messages.

    Returns:
        One flight with gyro [rad/s] and accel [m/s²] in FLU body axes, NaN in gaps of the log; quat (body to
        world, z up), NaN where the attitude is not known; `scored`, which marks the samples to score; and the
        `LogReport` as attribute `log`.

    Raises:
        FileNotFoundError: There is nothing at the path.
        ValueError: The format is unknown, the log is damaged, or the log lacks the chosen topic.
    """
    return resample(read_recording(path, mount=mount, truth=truth, imu=imu), rate_hz)[0]


def read_parts(log: Recording, rate_hz: float = 200.0) -> list[xr.Dataset]:
    """Read every part of a recording that is divided by long gaps, as `read_log` does.

    Short parts are dropped.
    """
    parts = split_at_gaps(log)
    names = [log.name if len(parts) == 1 else f"{log.name}, part {k + 1}" for k in range(len(parts))]
    return [resample(replace(part, name=name), rate_hz)[0] for part, name in zip(parts, names, strict=True)]


def refused(reports: Iterable[LogReport], force: bool = False) -> list[str]:
    """Return the faults of logs for which scores would be meaningless, one sentence each.

    Raises:
        ValueError: There is a fault and `force` is not set; the message gives the first fault and the number
            of others.
    """
    faults = list(
        dict.fromkeys(f"{report.log.path}: {fault}" for report in reports for fault in report.faults)
    )
    if faults and not force:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise ValueError(f"{faults[0]}{more}; --force uses it all the same")
    return faults


def read_recording(
    path: str | Path, *, mount: str | None = None, truth: str | None = None, imu: str | None = None
) -> Recording:
    """Read a log as `read_log` does, but keep the time stamps of the log."""
    path = Path(path).expanduser()
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such log")
    try:
        log = _read(path, truth, imu)
    except ModuleNotFoundError:  # of an extra
        raise
    except Exception as error:  # each library has errors of its own for a damaged file
        if isinstance(error, ValueError | OSError) and str(path) in str(error):
            raise
        raise ValueError(f"{path}: cannot be read: {str(error) or type(error).__name__}") from error
    log = replace(log, path=str(path))
    return log if mount is None else mounted(log, mount_matrix(mount))


def _read(path: Path, truth: str | None, imu: str | None) -> Recording:
    suffix = path.suffix.lower()
    if suffix in (".bag", ".db3", ".mcap") or (path / "metadata.yaml").is_file():
        return read_rosbag(path, imu, truth)
    if imu is not None:
        raise ValueError(f"{path}: an IMU topic can be chosen in ROS bags and MCAP only")
    if suffix == ".ulg":
        return read_ulog(path, truth)
    if path.is_dir() and euroc_folder(path) is not None:
        return read_euroc(path, truth)
    if truth is not None:
        raise ValueError(f"{path}: the truth can be chosen in ULog, EuRoC folders, ROS bags and MCAP only")
    if (read := BY_SUFFIX.get(suffix)) is not None:
        return read(path)
    if is_usdlog(path):
        return read_usdlog(path)
    hint = "; write a column map for it, see docs/reference/logs.md" if suffix == ".csv" else ""
    raise ValueError(f"{path}: not a log that can be read{hint}; known: {FORMATS}")
