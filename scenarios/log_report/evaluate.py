"""Estimators scored on real logs: tables, a CSV and a page, `quadsim evaluate --logs`."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from estimators.evaluation.logs import (
    KNOWN,
    NO_ATTITUDE,
    RAW,
    LogScores,
    default_names,
    score_logs,
    unscorable,
)
from estimators.tuned import DEFAULT_DOMAIN
from quadsim.logs import read_log, refused
from quadsim.logs.log_report import UNSCORED
from quadsim.runs.console import print_table, progress_bar, say

from ..report.contenders import Contenders
from .page import write_log_report
from .verdict import log_verdict


def tuning_of(contenders: Contenders) -> str:
    """Which parameters filters have, in a sentence."""
    if contenders.tuning is not None:
        return f"Filters have the parameters of {contenders.tuning}."
    if contenders.vehicle is not None:
        own = f"for {contenders.vehicle}, or else for {DEFAULT_DOMAIN}"
        return f"Filters have the parameters {own}; imm has one set for all vehicles."
    text = f"Filters have the parameters tuned on {DEFAULT_DOMAIN}, imm one set for all vehicles; "
    return text + "--vehicle and --tuning give others."


def evaluate_logs(
    paths: Sequence[Path],
    contenders: Contenders,
    out: Path,
    *,
    within_deg: float = 45.0,
    mount: str | None = None,
    force: bool = False,
) -> None:
    """Score estimators on logs: `quadsim evaluate --logs`.

    Args:
        paths: The logs.
        contenders: The estimators.
        out: Folder for the table and the page.
        within_deg: Largest true inclination that is scored [deg].
        mount: Rotation from IMU to body axes, as `quadsim.logs.recording.mount_matrix` takes it.
        force: Score a log although a unit or frame cannot be right.

    Raises:
        ValueError: A unit or frame of a log cannot be right, and `force` is not given; or no log has a sample
            that can be scored.
    """
    read = {path: read_log(path, mount=mount) for path in paths}
    reports = {path: log.attrs["log"] for path, log in read.items()}
    refused(reports.values(), force)
    reasons = {path: unscorable(log, within_deg=within_deg) for path, log in read.items()}
    left_out = {}
    for path, reason in reasons.items():
        far = reports[path].tilted if reason and "--within" in reason else ""
        if reason:
            left_out[path] = f"{path}: nothing to score: {reason}{f'; {far}' if far else ''}"
    used = sorted((path for path in paths if reasons[path] in (None, NO_ATTITUDE)), key=left_out.__contains__)
    if not used:
        raise ValueError(next(iter(left_out.values())))
    faults = {f"{path}: {each.sentence}" for path in read for each in reports[path].sensor_faults}
    warnings = [f"{path}: {warning}" for path, report in reports.items() for warning in report.warnings]
    warnings = [warning for warning in warnings if warning not in faults]  # the verdict says the faults
    warnings += [line for path, line in left_out.items() if f"{path}: {UNSCORED}" not in warnings]
    for warning in warnings:
        say(f"warning: {warning}", "yellow")
    logs = [read[path] for path in used]
    made = contenders.create(default_names(contenders.vehicle is not None), float(logs[0].attrs["rate_hz"]))
    with progress_bar("evaluate", "runs") as bar:
        scores = score_logs(logs, made, within_deg=within_deg, progress=bar)
    scores.tuning = tuning_of(contenders)
    scores.write_csv(out / "logs.csv")
    judged = log_verdict(scores)
    page = write_log_report(out / "report.html", scores, warnings)
    if scores.scored:
        without = ", logs without a fault" if scores.faulty and scores.faulty != scores.headline else ""
        title = f"Inclination RMSE within ±{within_deg:g}°{without}"
        print_table(_rows(scores), ("estimator", "raw, °", "silenced, °", "bias removed, °"), title)
    for log in scores.scored:
        say(f"{log}: {scores.logs[log].counted_s:.0f} s scored, {scores.logs[log].bias_text}")
    for line in judged.lines:
        say(line)
    say(f"{page}: {judged.headline}")


def _rows(scores: LogScores) -> Iterator[list[str]]:
    """Means over the logs of the headline."""
    for name in scores.estimators:
        values = scores.mean(name, RAW), scores.silenced(name), scores.mean(name, KNOWN)
        yield [name, *("–" if math.isnan(value) else f"{value:.2f}" for value in values)]
