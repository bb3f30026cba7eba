"""Verbs that compare: `evaluate` on recorded flights and logs, `paper` for all of the paper's results."""

from pathlib import Path
from typing import Annotated

import typer

from ..runs.console import output as console
from ..runs.console import progress_bar
from ..runs.files import alone
from .options import Mount, Seed, Workers


def evaluate(
    data: Annotated[
        Path | None, typer.Option(help="Dataset of flights that were not tuned or trained on.")
    ] = None,
    logs: Annotated[
        list[Path] | None, typer.Option(help="Real log in place of --data; give it again for more.")
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            help="Estimator: a name, weights or your module:Class; again for more. All if left out."
        ),
    ] = None,
    within: Annotated[
        float, typer.Option(min=1, max=180, help="With --logs: largest true inclination scored, in °.")
    ] = 45.0,
    mount: Mount = None,
    tuning: Annotated[
        str | None,
        typer.Option(
            help="Tuned parameters: a shipped domain or a TOML file; those shipped for the dataset's vehicle "
            "when left out."
        ),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Airframe that ekf-drag takes its drag from: a shipped name or a TOML file. "
            "A dataset's own when left out; a log has none."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the table, its figures and the report.")] = Path(
        "reports/evaluate"
    ),
    force: Annotated[
        bool,
        typer.Option("--force", help="With --logs: score them although a unit or frame cannot be right."),
    ] = False,
    seed: Seed = 0,
) -> None:
    """Compare estimators on recorded flights: errors, convergence, run time, with confidence intervals.

    Each is also compared with the best one flight by flight; those that are not significantly different from
    it are tied. Beside a network's error stands that of the same network silenced: with output weights of
    zero. Writes evaluation.csv, the violins and the convergence as PNG, and report.html; of real logs
    logs.csv with a row "level" that shows how hard the log is, and report.html: traces of readings,
    attitudes and errors on one time axis.

    Rotor speeds that a dataset or a log holds are given to the estimators that use them: of those that ship,
    imm.

    Example: quadsim evaluate --data data/test.zarr --estimator mahony --estimator att-snn-loihi
    """
    if (data is None) == (not logs):
        raise ValueError("one of --data and --logs is required")
    from scenarios.report.contenders import Contenders

    contenders = Contenders(estimator, tuning, vehicle)
    if logs:
        import numpy as np

        from scenarios.log_report.evaluate import evaluate_logs

        # of numbers that no sensor has, which are refused
        with alone(out), np.errstate(over="ignore", invalid="ignore"):
            evaluate_logs(logs, contenders, out, within_deg=within, mount=mount, force=force)
        return
    if mount is not None:
        raise ValueError("--mount is of the IMU of --logs; a dataset is in body axes")
    assert data is not None
    from scenarios.report.evaluation import evaluate_dataset

    with alone(out):
        evaluate_dataset(data, contenders, out, seed=seed)


def paper(
    out: Annotated[Path, typer.Option(help="Folder for the pages and for all that they come from.")],
    only: Annotated[
        str | None,
        typer.Option(
            help="Some of it, such as table1,fig5: table1 table2 fig3 to fig9 operations loop rate minutes."
        ),
    ] = None,
    preset: Annotated[
        str, typer.Option(help="quick: short flights and trainings, for a look; full: the paper's sizes.")
    ] = "quick",
    seed: Seed = 0,
    workers: Workers = None,
) -> None:
    """Make every table and figure of the paper from nothing, and judge which of its claims hold here.

    Stroobants, Dupeyroux and de Croon (2022), without a Loihi, a quadrotor or a motion-capture hall: flights
    are generated, filters tuned, networks trained and simulated. Writes paper.md with its figures.

    quick takes some minutes on two cores and gives no verdicts; full takes a night. Every part is stored in
    the folder: the same command resumes a killed run, and makes nothing twice.

    Example: quadsim paper --out reports/paper --only table2,fig6
    """
    from paper.run import paper as make_paper
    from scenarios.report.terminal import plain_table

    with alone(out), progress_bar("paper", "stages") as bar:
        done = make_paper(out, only, preset, seed, workers, bar)
    rows = [(each.claim, each.verdict) for each in done.judged if each.verdict != "not judged"]
    if rows:
        console.print(plain_table(rows))
    console.print(f"{done.page}: {done.headline}", soft_wrap=True)
