"""Estimators scored on real logs: a table, a CSV and pictures, `quadsim evaluate --logs`."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from estimators.evaluation.logs import (
    KNOWN,
    NO_ATTITUDE,
    RAW,
    LogScores,
    compare_logs,
    default_names,
    draw_log,
    score_logs,
    unscorable,
)
from estimators.tuned import DEFAULT_DOMAIN
from quadsim.logs import read_log_and_report, refused
from quadsim.logs.log_report import UNSCORED
from quadsim.runs.console import output, progress_bar
from quadsim.runs.files import save_figure

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
        out: Folder for the table and the pictures.
        within_deg: Largest true inclination that is scored [deg].
        mount: Rotation from IMU to body axes, as `quadsim.logs.mounting.mount_matrix` takes it.
        force: Score a log although a unit or frame cannot be right.

    Raises:
        ValueError: A unit or frame of a log cannot be right, and `force` is not given; or no log has a sample
            that can be scored.
    """
    read = {path: read_log_and_report(path, mount=mount) for path in paths}
    refused([(path, report) for path, (_, report) in read.items()], force)
    warnings = [f"{path}: {warning}" for path, (_, report) in read.items() for warning in report.warnings]
    reasons = {path: unscorable(log, within_deg=within_deg) for path, (log, _) in read.items()}
    for path, (_, report) in read.items():
        if reasons[path] and "--within" in str(reasons[path]) and report.far_from_level:
            reasons[path] = f"{reasons[path]}; {report.far_from_level}"
    left_out = [f"{path}: nothing to score: {reason}" for path, reason in reasons.items() if reason]
    without = [path for path, reason in reasons.items() if reason == NO_ATTITUDE]
    if len(left_out) == len(read) and not without:
        raise ValueError(left_out[0])
    known = " ".join(warnings)
    warnings += [line for line in left_out if f"{line.split(': nothing')[0]}: {UNSCORED}" not in known]
    for warning in warnings:
        output.print(f"warning: {warning}", style="yellow", markup=False, soft_wrap=True)
    logs = [log for path, (log, _) in read.items() if not reasons[path]]
    others = [read[path][0] for path in without]
    rate = float((logs + others)[0].attrs["rate_hz"])
    made = contenders.create(default_names(contenders.vehicle is not None), rate)
    with progress_bar("evaluate", "runs") as bar:
        scores = score_logs(logs, made, within_deg=within_deg, progress=bar) if logs else LogScores()
        compare_logs(scores, others, made, progress=bar)
    scores.tuning = tuning_of(contenders)
    output.print(scores.tuning, soft_wrap=True)
    scores.write_csv(out / "logs.csv")
    for log in scores.truth:
        save_figure(out / f"{log}.png", draw_log(scores, log), dpi=110)
    faults = {
        f"{path}: {each.sentence}" for path, (_, report) in read.items() for each in report.sensor_faults
    }
    others_said = [warning for warning in warnings if warning not in faults]  # the verdict says the faults
    page = write_log_report(out / "report.html", logs + others, scores, others_said)
    headings = ("estimator", "raw, °", "silenced, °", "bias removed, °")
    apart = scores.faulty if scores.headline != scores.faulty else []
    over = ", logs without a fault" if apart else ""
    table = Table(*headings, title=f"Inclination RMSE within ±{within_deg:g}°{over}")
    for name in scores.estimators if logs else ():
        errors = scores.mean(name, RAW), scores.silenced(name), scores.mean(name, KNOWN)
        table.add_row(name, *("–" if math.isnan(error) else f"{error:.2f}" for error in errors))
    if logs:
        output.print(table)
    for log in apart:
        faults = ", ".join(fault.name for fault in scores.faults[log])
        table = Table("estimator", "raw, °", "bias removed, °", title=f"{log}, apart: {faults}")
        for name in scores.estimators:
            errors = (scores.on_log(log, name, which) for which in (RAW, KNOWN))
            table.add_row(name, *("–" if math.isnan(error) else f"{error:.2f}" for error in errors))
        output.print(table)
    if scores.faulty and not apart:
        where = "the log: the errors are" if len(scores.faulty) == 1 else "every log: means are"
        output.print(f"A fault of a sensor begins in {where} of faulty readings.", soft_wrap=True)
    for log, found in scores.comparisons.items():
        table = Table(
            "estimator", "horizontal force, m/s²", "from others, °", title=f"{log}: no true attitude"
        )
        for name, size in sorted(found.force.items(), key=lambda each: each[1]):
            pairs = [pair for names, pair in found.apart.items() if name in names]
            median, most = np.median(pairs, axis=0) if pairs else (math.nan, math.nan)
            differ = f"{median:.1f}, 95th percentile {most:.1f}" if pairs else "–"
            table.add_row(name, f"{size:.2f}", differ)
        output.print(table)
        for name, flaw in found.flaws.items():
            output.print(f"{log}: {name} {flaw}: it is not compared", soft_wrap=True, markup=False)
    for row in scores.rows:
        if row.flaw and row.bias == RAW:
            counted = "; each of these counts as 180°" if row.without_number > 0.0 else ""
            text = f"{row.log}: {row.estimator} {row.flaw}{counted}: it is not ranked"
            output.print(text, soft_wrap=True, markup=False)
    for log, counted in scores.counted.items():
        if log in scores.comparisons:
            continue
        text = f"{log}: {counted.sum() / rate:.0f} s scored, {scores.bias_text(log)}"
        output.print(text, soft_wrap=True, highlight=False)
    for (log, name), believed in scores.beliefs.items():
        shares = ", ".join(f"{model} {100.0 * share:.0f} %" for model, share in believed.share().items())
        if log in scores.comparisons:
            text = f"{log}: {name} believed {shares}; its σ is {believed.sigma_deg:.1f}° in the median"
            output.print(text, soft_wrap=True, highlight=False)
            continue
        honest = believed.interval(scores.truth[log][None], scores.counted[log][None]).text
        output.print(f"{log}: {name} believed {shares}; {honest}", soft_wrap=True, highlight=False)
    output.print(f"{page}: {log_verdict(scores).headline}", soft_wrap=True)
