"""Functions for real logs: show them, convert them to datasets, calibrate an IMU."""

from pathlib import Path

from ..runs.console import say


def show_log(file: Path, mount: str | None, truth: str | None, imu: str | None) -> None:
    """Print the contents of a log, its problems, and which signal is used as the truth."""
    from ..logs import read_log
    from ..logs.log_report import show_report

    show_report(file, read_log(file, mount=mount, truth=truth, imu=imu).attrs["log"])


def show_mount(file: Path, mount: str | None, truth: str | None, imu: str | None, level: bool) -> None:
    """Estimate the rotation from IMU to body axes, and print the --mount that gives it.

    If the log has the body's true attitude, this is the rotation that fits the gyroscope's rates to the true
    ones. Otherwise roll and pitch follow from hover, in which the mean force is along body z; the heading is
    that of `mount`, or zero.
    """
    from ..logs import read_log
    from ..logs.mounting import estimate_mount, show_estimate

    show_estimate(file, estimate_mount(read_log(file, mount=mount, truth=truth, imu=imu), mount, level))


def convert_logs(
    files: list[Path],
    out: Path,
    piece: float,
    rate: float,
    mount: str | None,
    truth: str | None,
    imu: str | None,
    force: bool,
) -> None:
    """Convert logs to a dataset: pieces of equal length without gaps and with a known attitude."""
    from ..logs import read_parts, read_recording, refused
    from ..logs.convert import convert

    recordings = [read_recording(file, mount=mount, truth=truth, imu=imu) for file in files]
    logs = [part for each in recordings for part in read_parts(each, rate)]
    for fault in refused([log.attrs["log"] for log in logs], force):
        say(f"warning: {fault}", "yellow")
    convert(logs, out, piece)


def calibrate_imu(file: Path, out: Path, mount: str | None, imu: str | None) -> None:
    """Measure an IMU at rest (Allan variance); write an IMU file for `quadsim generate`."""
    from ..logs import read_recording
    from ..logs.allan import calibrate, show_calibration

    if out.suffix != ".toml" or out.absolute() == file.absolute():
        raise ValueError(f"{out}: an IMU file ends in .toml, and is not the log")
    show_calibration(calibrate(read_recording(file, mount=mount, imu=imu)), out)
