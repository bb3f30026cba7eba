"""Estimators scored on real logs: tables, a CSV and a page, `quadsim evaluate --logs`."""

from collections.abc import Callable, Sequence
from pathlib import Path

from estimators.evaluation.comparison import made_of
from estimators.evaluation.logs import KINDS, NO_ATTITUDE, default_names, prepared, score_logs
from estimators.tuned import DEFAULT_DOMAIN
from quadsim.logs import read_log, refused
from quadsim.logs.log_report import UNSCORED
from quadsim.pictures.timeline import Timeline
from quadsim.runs.console import print_table, progress_bar, say

from .log_page import write_log_report
from .log_timeline import timeline_of_log
from .log_verdict import log_verdict


def evaluate_logs(
    paths: Sequence[Path],
    out: Path,
    names: Sequence[str] | None,
    tuning: str | None,
    vehicle: str | None,
    *,
    within_deg: float = 45.0,
    mount: str | None = None,
    force: bool = False,
    show: Callable[[Timeline], object] | None = None,
) -> None:
    """Score estimators on logs: `quadsim evaluate --logs`.

    Args:
        paths: The logs.
        out: Folder for the table and the page.
        names: The estimators; None for those that logs are scored with.
        tuning: Where their parameters come from, as `estimators.create` takes it.
        vehicle: The airframe, if it is known.
        within_deg: Largest true inclination that is scored [deg].
        mount: Rotation from IMU to body axes, as `quadsim.logs.recording.mount_matrix` takes it.
        force: Score a log although a unit or frame cannot be right.
        show: Called with what viewers show of the first log.

    Raises:
        ValueError: A unit or frame of a log cannot be right, and `force` is not given; or no log has a sample
            that can be scored.
    """
    read = {path: read_log(path, mount=mount) for path in paths}
    reports = {path: log.attrs["log"] for path, log in read.items()}
    refused(reports.values(), force)
    left_out, warnings, used = [], [], []
    for path, log in read.items():
        report, reason = reports[path], prepared(log, within_deg).unscorable
        faults = [fault.sentence for fault in report.sensor_faults]  # which the verdict says
        name = log.attrs["source"]
        warnings += [f"{name}: {warning}" for warning in report.warnings if warning not in faults]
        if reason in ("", NO_ATTITUDE):
            used.append((reason, path))
        if reason:
            mend = f"; {report.tilted}" if report.tilted and "--within" in reason else ""
            left_out.append(f"{name}: nothing to score: {reason}{mend}")
            warnings += [left_out[-1]] if UNSCORED not in report.warnings else []
    if not used:
        raise ValueError(left_out[0])
    for warning in warnings:
        say(f"warning: {warning}", "yellow")
    logs = [read[path] for _, path in sorted(used, key=lambda each: each[0])]
    rate_hz = float(logs[0].attrs["rate_hz"])
    made = made_of(names or default_names(vehicle is not None), rate_hz, tuning, vehicle)
    with progress_bar("evaluate", "runs") as bar:
        scores = score_logs(logs, made, within_deg=within_deg, progress=bar)
    if show is not None:
        show(timeline_of_log(logs[0], scores.logs[str(logs[0].attrs["source"])], made, vehicle))
    if tuning is not None:
        scores.tuning = f"Filters have the parameters of {tuning}."
    else:
        own = f"for {vehicle}, or else for" if vehicle else "tuned on"
        scores.tuning = (
            f"Filters have the parameters {own} {DEFAULT_DOMAIN}; imm has one set for all vehicles."
        )
    scores.write_csv(out / "logs.csv")
    judged = log_verdict(scores)
    page = write_log_report(out / "report.html", scores, warnings)
    if scores.scored:
        without = ", logs without a fault" if scores.faulty and scores.faulty != scores.headline else ""
        title = f"Inclination RMSE within ±{within_deg:g}°{without}"
        rows = [
            [name, *(f"{scores.mean(name, kind):.2f}".replace("nan", "–") for kind in KINDS)]
            for name in scores.estimators
        ]
        print_table(rows, ("estimator", "raw, °", "bias removed, °", "silenced, °"), title)
    for log in scores.scored:
        say(f"{log}: {scores.logs[log].counted_s:.0f} s scored, {scores.logs[log].bias_text}")
    for line in judged.lines:
        say(line)
    say(f"{page}: {judged.headline}")
