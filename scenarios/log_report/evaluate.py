"""Estimators scored on real logs: tables, a CSV and a page, `quadsim evaluate --logs`."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

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
        mount: Rotation from IMU to body axes, as `quadsim.logs.mounting.mount_matrix` takes it.
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
        far = reports[path].far_from_level if reason and "--within" in reason else ""
        if reason:
            left_out[path] = f"{path}: nothing to score: {reason}{f'; {far}' if far else ''}"
    used = sorted((path for path in paths if reasons[path] in (None, NO_ATTITUDE)), key=left_out.__contains__)
    if not used:
        raise ValueError(next(iter(left_out.values())))
    warnings = [f"{path}: {warning}" for path, report in reports.items() for warning in report.warnings]
    warnings += [line for path, line in left_out.items() if f"{path}: {UNSCORED}" not in warnings]
    for warning in warnings:
        say(f"warning: {warning}", "yellow")
    logs = [read[path] for path in used]
    made = contenders.create(default_names(contenders.vehicle is not None), float(logs[0].attrs["rate_hz"]))
    with progress_bar("evaluate", "runs") as bar:
        scores = score_logs(logs, made, within_deg=within_deg, progress=bar)
    scores.tuning = tuning_of(contenders)
    scores.write_csv(out / "logs.csv")
    faults = {f"{path}: {each.sentence}" for path in read for each in reports[path].sensor_faults}
    others = [warning for warning in warnings if warning not in faults]  # the verdict says the faults
    page = write_log_report(out / "report.html", scores, others)
    say(scores.tuning)
    _show_errors(scores, within_deg)
    _show_comparisons(scores)
    _show_notes(scores)
    say(f"{page}: {log_verdict(scores).headline}")


def _cells(values: Iterable[float]) -> list[str]:
    return ["–" if math.isnan(value) else f"{value:.2f}" for value in values]


def _show_errors(scores: LogScores, within_deg: float) -> None:
    """Errors over the logs of the headline, and on each faulty log apart."""
    apart = scores.faulty if scores.headline != scores.faulty else []
    title = f"Inclination RMSE within ±{within_deg:g}°{', logs without a fault' if apart else ''}"
    rows = [
        (name, *_cells((scores.mean(name, RAW), scores.silenced(name), scores.mean(name, KNOWN))))
        for name in scores.estimators
    ]
    if scores.scored:
        print_table(rows, ("estimator", "raw, °", "silenced, °", "bias removed, °"), title)
    for log in apart:
        faults = ", ".join(fault.name for fault in scores.logs[log].faults)
        raw, known = (scores.on_logs(bias)[log].to_dict() for bias in (RAW, KNOWN))
        rows = [(name, *_cells((raw[name], known[name]))) for name in scores.estimators if name in raw]
        print_table(rows, ("estimator", "raw, °", "bias removed, °"), f"{log}, apart: {faults}")
    if scores.faulty and not apart:
        where = "the log: the errors are" if len(scores.faulty) == 1 else "every log: means are"
        say(f"A fault of a sensor begins in {where} of faulty readings.")


def _show_comparisons(scores: LogScores) -> None:
    """Forces and differences of estimators on each log without a true attitude."""
    for log, found in scores.compared.items():
        rows = []
        for name, size in sorted(found.force.items(), key=lambda each: each[1]):
            pairs = [pair for names, pair in found.apart.items() if name in names]
            median, most = np.median(pairs, axis=0) if pairs else (math.nan, math.nan)
            differ = f"{median:.1f}, 95th percentile {most:.1f}" if pairs else "–"
            rows.append((name, f"{size:.2f}", differ))
        headings = ("estimator", "horizontal force, m/s²", "from others, °")
        print_table(rows, headings, f"{log}: no true attitude")
        for name, flaw in found.flaws.items():
            say(f"{log}: {name} {flaw}: it is not compared")


def _show_notes(scores: LogScores) -> None:
    """Estimators that are not ranked, what of each log counts, and what estimators believed."""
    for row in scores.table.to_dict("records"):
        if row["flaw"] and row["bias"] == RAW:
            counted = "; each of these counts as 180°" if row["without_number"] > 0.0 else ""
            say(f"{row['log']}: {row['estimator']} {row['flaw']}{counted}: it is not ranked")
    for log in scores.scored:
        say(f"{log}: {scores.logs[log].counted_s:.0f} s scored, {scores.logs[log].bias_text}")
    for log, one in scores.logs.items():
        for name, believed in one.beliefs.items():
            shares = ", ".join(f"{model} {100.0 * share:.0f} %" for model, share in believed.share().items())
            say(f"{log}: {name} believed {shares}; {one.honesty(name)}")
