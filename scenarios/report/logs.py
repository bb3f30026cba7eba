"""Estimators scored on real logs, from files to a table, a CSV and pictures: `quadsim evaluate --logs`."""

import math
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from estimators import create
from estimators.evaluation.logs import KNOWN, RAW, default_names, draw_log, score_logs
from estimators.networks.weights_file import load_network
from quadsim.estimator import AttitudeEstimator
from quadsim.imu.spec import ImuSpec
from quadsim.logs import read_log_and_report, refused
from quadsim.runs.console import output, progress_bar
from quadsim.runs.files import save_figure
from quadsim.vehicle import Vehicle


def made_of(
    names: Sequence[str],
    weights: Sequence[str],
    rate_hz: float,
    tuning: str | None,
    vehicle: str | Path | Vehicle | None = None,
    imu: str | Path | ImuSpec | None = None,
) -> dict[str, AttitudeEstimator]:
    """Estimators by name, and networks by the paths of their weights.

    Raises:
        ValueError: Weights of another kind of network, or given twice; a filter that needs a vehicle without
            one.
    """
    made = {name: create(name, rate_hz, tuning=tuning, vehicle=vehicle, imu=imu) for name in names}
    for path in weights:
        if path in made:
            raise ValueError(f"--weights {path}: given twice, or the name of an estimator")
        made[path] = create(load_network(path)[0].model, rate_hz, weights=path)
    return made


def evaluate_logs(
    paths: Sequence[Path],
    estimators: Sequence[str] | None,
    weights: Sequence[str],
    within_deg: float,
    axes: str | None,
    tuning: str | None,
    vehicle: str | None,
    out: Path,
    force: bool = False,
) -> None:
    """Score estimators on logs: `quadsim evaluate --logs`.

    Raises:
        ValueError: What a log holds cannot be right, and it is not to be scored by force.
    """
    read = {path: read_log_and_report(path, axes=axes) for path in paths}
    for fault in refused([(path, report) for path, (_, report) in read.items()], force):
        output.print(f"warning: {fault}", style="yellow", markup=False, soft_wrap=True)
    logs = [log for log, _ in read.values()]
    rate = float(logs[0].attrs["rate_hz"])
    made = made_of(estimators or default_names(vehicle is not None), weights, rate, tuning, vehicle)
    with progress_bar("evaluate", "runs") as bar:
        scores = score_logs(logs, made, within_deg=within_deg, progress=bar)
    scores.write_csv(out / "logs.csv")
    for log in scores.truth:
        save_figure(out / f"{log}.png", draw_log(scores, log), dpi=110)
    headings = ("estimator", "raw, °", "silenced, °", "bias removed, °")
    table = Table(*headings, title=f"Inclination RMSE within ±{within_deg:g}°")
    for name in scores.estimators:
        silenced = scores.silenced(name)
        table.add_row(
            name,
            f"{scores.mean(name, RAW):.2f}",
            "–" if math.isnan(silenced) else f"{silenced:.2f}",
            f"{scores.mean(name, KNOWN):.2f}",
        )
    output.print(table)
    for row in scores.rows:
        if row.without_number > 0.0 and row.bias == RAW:
            output.print(
                f"{row.log}: {100.0 * row.without_number:.1f} % of the estimates of {row.estimator} are "
                "no number; each counts as 180°",
                soft_wrap=True,
            )
    for log, bias in scores.gyro_bias.items():
        found = ", ".join(f"{math.degrees(value):+.2f}" for value in bias)
        seconds = scores.counted[log].sum() / rate
        output.print(
            f"{log}: {seconds:.0f} s scored, gyro bias ({found}) °/s", soft_wrap=True, highlight=False
        )
    best = scores.estimators[0]
    output.print(
        f"{out / 'logs.csv'}: the smallest raw error is {best}'s, {scores.mean(best, RAW):.2f}°",
        soft_wrap=True,
    )
