"""What verbs do with real logs: look at them, make datasets of them, calibrate an IMU from them."""

import math
from pathlib import Path

from rich.table import Table

from ..runs.console import output
from ..runs.files import save_figure


def show_log(file: Path, mount: str | None, truth: str | None, imu: str | None) -> None:
    """Print what a log holds, what is odd about it, and what was taken for the truth."""
    from ..logs import read_log_and_report

    _, report = read_log_and_report(file, mount=mount, truth=truth, imu=imu)
    table = Table(show_header=False)
    rows = {
        "format": report.format,
        "samples": f"{report.samples} in {report.duration_s:.2f} s",
        "sample rate": f"{report.source_rate_hz:.2f} Hz, {report.jitter_ms:.3f} ms SD from step to step",
        "brought to": "200 Hz"
        + (f", low-pass at {report.filter_hz:g} Hz" if report.filter_hz else ", nothing to filter"),
        "gaps": f"{report.gaps}, {report.gap_s:.3f} s in all, longest {report.longest_gap_s:.3f} s",
        "single samples lost": str(report.lost),
        "stamps not after the last": str(report.stamps_back),
        "repeated samples": str(report.repeated),
        "saturated samples": str(report.saturated),
        "samples not numbers": str(report.missing),
        "truth": report.truth,
        "truth known": f"{100 * report.truth_share:.1f} % of the time, at {report.truth_rate_hz:.1f} Hz",
    }
    if report.gravity is not None:
        x, y, z = report.gravity
        rows["mean force in the world"] = f"({x:.2f}, {y:.2f}, {z:.2f}) m/s²"
    if report.truth_delay_s is not None:
        rows["truth late by"] = f"{1e3 * report.truth_delay_s:.1f} ms, correlation {report.agreement:.3f}"
        rows["gyroscope over truth"] = f"{report.slope:.3f}"
    rows["specific force"] = (
        f"median {report.weight:.2f} m/s², {100 * report.upright:.0f} % of it along body z"
    )
    for key, value in rows.items():
        table.add_row(key, value)
    for note in report.notes:
        table.add_row("note", note)
    output.print(table)
    for warning in report.warnings:
        output.print(f"! {warning}", soft_wrap=True, highlight=False)
    count = len(report.warnings)
    verdict = "nothing odd" if not count else f"{count} {'thing' if count == 1 else 'things'} to know"
    output.print(f"{file}: {report.duration_s:.1f} s, {verdict}", soft_wrap=True)


def show_mount(file: Path, mount: str | None, truth: str | None, imu: str | None, level: bool) -> None:
    """Print how the IMU is mounted: the --mount that makes IMU axes the body's.

    From the true attitude, where the log has one of the body: the rotation that brings the gyroscope's rates
    nearest to the truth's. Else from hover, in which the mean force is along body z: roll and pitch; the
    heading is that of the mount given, or zero.
    """
    from ..logs import read_recording
    from ..logs.mount_estimate import estimate_mount
    from ..logs.mounting import mount_text

    found = estimate_mount(read_recording(file, mount=mount, truth=truth, imu=imu), mount, level)
    table = Table(show_header=False)
    x, y, z = found.sd_deg
    table.add_row("from", found.by)
    table.add_row("rotation", f"{found.angle_deg:.2f}°")
    table.add_row("1 SD about body x, y", f"{x:.2f}°, {y:.2f}°")
    table.add_row("1 SD about body z", f"{z:.2f}°" if z < math.inf else "the heading does not show")
    if found.accel_bias is not None:
        x, y = found.accel_bias
        table.add_row("accelerometer bias, body x, y", f"{x:+.2f}, {y:+.2f} m/s²")
    output.print(table)
    if found.accel_bias is None:
        line = "the log cannot separate the accelerometer's bias from a tilt of the IMU: the mount takes both"
        output.print(f"! {line} together", soft_wrap=True)
    elif found.levelled:
        line = "the accelerometer's bias hides a part of the IMU's tilt: the mount takes both together"
        output.print(f"! {line}, so that no filter's error rises", soft_wrap=True)
    output.print(f'{file}: --mount "{mount_text(found.body_from_imu)}"', soft_wrap=True, highlight=False)


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
    """Make a dataset of logs: pieces of one length, without gaps and with a known attitude."""
    from ..logs import read_parts, refused
    from ..logs.convert import convert

    read = [(file, read_parts(file, rate, mount=mount, truth=truth, imu=imu)) for file in files]
    for fault in refused([(file, report) for file, parts in read for _, report in parts], force):
        output.print(f"warning: {fault}", style="yellow", markup=False, soft_wrap=True)
    logs = [log for _, parts in read for log, _ in parts]
    path = convert(logs, out, piece)
    from ..dataset.reading import open_dataset

    pieces = open_dataset(path).sizes["flight"]
    total = sum(float(log.attrs["duration_s"]) for log in logs)
    output.print(
        f"{out}: {pieces} pieces of {piece:g} s, {100 * pieces * piece / total:.0f} % of {total:.0f} s",
        soft_wrap=True,
    )


def calibrate_imu(
    files: list[Path], out: Path, gravity: float, mount: str | None, imu: str | None, bias_only: bool
) -> None:
    """Measure an IMU's noise from still logs (Allan variance), as a file for `generate --set imu=FILE`."""
    from ..logs import read_recording
    from ..logs.allan import calibrate, draw, write_imu

    logs = [read_recording(file, mount=mount, imu=imu) for file in files]
    found = calibrate(logs, gravity, bias_only=bias_only)
    biases = Table("sensor", "bias x", "y", "z", "1 SD by noise")
    for (name, unit, sensor), seen in zip(found.sensors, ("", ", along gravity"), strict=True):
        values = (f"{value:+.5f}" for value in sensor.bias)
        biases.add_row(f"{name}{seen}, {unit}", *values, f"{sensor.bias_sd:.5f}")
    output.print(biases)
    if bias_only:
        rates = ", ".join(f"{math.degrees(value):+.3f}" for value in found.gyro.bias)
        text = f"{', '.join(found.logs)}: gyroscope bias ({rates}) °/s, from {found.still_s:.0f} s at rest"
        output.print(text, soft_wrap=True, highlight=False)
        return
    write_imu(found, out)
    save_figure(out.with_suffix(".png"), draw(found), dpi=130)
    table = Table("sensor", "noise density", "bias random walk", "time constant, s", "turn-on bias")
    for name, sensor in (("gyro, rad/s", found.gyro), ("accel, m/s²", found.accel)):
        tau = f"{'' if sensor.resolved else '> '}{sensor.time_constant:.0f}" if sensor.random_walk else "-"
        noise = "-" if sensor.noise is None else f"{sensor.noise:.4g}"
        walk = f"{sensor.random_walk:.4g}" if sensor.random_walk else "-"
        table.add_row(name, noise, walk, tau, f"{sensor.turn_on:.3g}")
    output.print(table)
    for line in found.lacking:
        output.print(f"! {line}", soft_wrap=True, highlight=False)
    output.print(
        f"{out}: an IMU from {found.still_s:.0f} s at rest; quadsim generate --set imu={out}", soft_wrap=True
    )
