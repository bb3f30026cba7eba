"""Estimators scored on real logs: a table, a CSV and pictures, `quadsim evaluate --logs`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from estimators import create
from estimators.evaluation.comparison import made_of
from estimators.evaluation.logs import KNOWN, RAW, default_names, draw_log, score_logs
from estimators.networks.weights_file import load_network
from quadsim.estimator import AttitudeEstimator
from quadsim.imu.spec import ImuSpec
from quadsim.logs import read_log_and_report, refused
from quadsim.runs.console import output, progress_bar
from quadsim.runs.files import save_figure
from quadsim.vehicle import Vehicle


@dataclass(frozen=True)
class Contenders:
    """Estimators to be compared, as the command line names them."""

    names: Sequence[str] | None = None
    """None for all that can be made."""
    weights: Sequence[str] = ()
    """Weights files, each under its path."""
    tuning: str | None = None
    vehicle: str | None = None

    def create(
        self,
        default: Sequence[str],
        rate_hz: float,
        vehicle: str | Path | Vehicle | None = None,
        imu: ImuSpec | None = None,
    ) -> dict[str, AttitudeEstimator]:
        """Make them; `default` names and the `vehicle` stand in where none are given.

        Raises:
            ValueError: Weights of another kind of network, or given twice; a filter that needs a vehicle
                without one.
        """
        made = made_of(self.names or default, rate_hz, self.tuning, self.vehicle or vehicle, imu)
        for path in self.weights:
            if path in made:
                raise ValueError(f"--weights {path}: given twice, or the name of an estimator")
            made[path] = create(load_network(path)[0].model, rate_hz, weights=path)
        return made


def evaluate_logs(
    paths: Sequence[Path],
    contenders: Contenders,
    out: Path,
    *,
    within_deg: float = 45.0,
    axes: str | None = None,
    force: bool = False,
) -> None:
    """Score estimators on logs: `quadsim evaluate --logs`.

    Args:
        paths: The logs.
        contenders: The estimators.
        out: Folder for the table and the pictures.
        within_deg: Largest true inclination that is scored [deg].
        axes: Body axes in the sensors', as "z,-y,x".
        force: Score a log although a unit or frame cannot be right.

    Raises:
        ValueError: A unit or frame of a log cannot be right, and `force` is not given.
    """
    read = {path: read_log_and_report(path, axes=axes) for path in paths}
    for fault in refused([(path, report) for path, (_, report) in read.items()], force):
        output.print(f"warning: {fault}", style="yellow", markup=False, soft_wrap=True)
    logs = [log for log, _ in read.values()]
    rate = float(logs[0].attrs["rate_hz"])
    made = contenders.create(default_names(contenders.vehicle is not None), rate)
    with progress_bar("evaluate", "runs") as bar:
        scores = score_logs(logs, made, within_deg=within_deg, progress=bar)
    scores.write_csv(out / "logs.csv")
    for log in scores.truth:
        save_figure(out / f"{log}.png", draw_log(scores, log), dpi=110)
    headings = ("estimator", "raw, °", "silenced, °", "bias removed, °")
    table = Table(*headings, title=f"Inclination RMSE within ±{within_deg:g}°")
    for name in scores.estimators:
        errors = scores.mean(name, RAW), scores.silenced(name), scores.mean(name, KNOWN)
        table.add_row(name, *("–" if math.isnan(error) else f"{error:.2f}" for error in errors))
    output.print(table)
    for row in scores.rows:
        if row.without_number > 0.0 and row.bias == RAW:
            share = f"{100.0 * row.without_number:.1f} % of the estimates of {row.estimator}"
            output.print(f"{row.log}: {share} are no number; each counts as 180°", soft_wrap=True)
    for log, bias in scores.gyro_bias.items():
        shown = ", ".join(f"{math.degrees(value):+.2f}" for value in bias)
        text = f"{log}: {scores.counted[log].sum() / rate:.0f} s scored, gyro bias ({shown}) °/s"
        output.print(text, soft_wrap=True, highlight=False)
    for (log, name), believed in scores.beliefs.items():
        shares = ", ".join(f"{model} {100.0 * share:.0f} %" for model, share in believed.share().items())
        inside = believed.coverage(scores.truth[log][None], scores.counted[log][None])
        text = f"{log}: {name} believed {shares}; {100.0 * inside:.0f} % of the truth is in its 95 % interval"
        output.print(text, soft_wrap=True, highlight=False)
    best = scores.estimators[0]
    last = f"the smallest raw error is {best}'s, {scores.mean(best, RAW):.2f}°"
    output.print(f"{out / 'logs.csv'}: {last}", soft_wrap=True)
