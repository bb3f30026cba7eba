"""Commands that compare: `evaluate` on recorded flights and logs, `paper` for the paper's results."""

from pathlib import Path
from typing import Annotated

import typer

from ..runs.console import print_table, progress_bar, say
from ..runs.files import alone
from .options import Force, Mcap, Mount, Rerun, Seed, Workers, settings_of


def evaluate(
    data: Annotated[
        Path | None,
        typer.Option(
            help="Dataset to score estimators on. Use flights that were not used for training or tuning."
        ),
    ] = None,
    logs: Annotated[
        list[Path] | None,
        typer.Option(help="Log to score estimators on, instead of --data. Repeat the option to add more."),
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            help="Estimator: a name, weights or your own file.py:Class. Repeat the option to add more. "
            "Default: all."
        ),
    ] = None,
    within: Annotated[
        float,
        typer.Option(
            min=1,
            max=180,
            help="For logs: score only samples whose true inclination is at most this, in degrees.",
        ),
    ] = 45.0,
    mount: Mount = None,
    rerun: Rerun = None,
    mcap: Mcap = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Parameters of filters, as name=value. tuning: a shipped name or a file from quadsim tune "
            "(default: the parameters tuned for the vehicle). vehicle: the airframe for ekf-drag, as a "
            "shipped name or a TOML file (default: the vehicle of the dataset; there is no default for "
            "logs). Repeat the option to set more.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the table, the figures and the report.")] = Path(
        "reports/evaluate"
    ),
    force: Force = False,
    seed: Seed = 0,
) -> None:
    """Compare estimators on stored flights or logs: errors with confidence intervals, convergence, run time.

    The command compares each estimator with the best one, flight by flight. Two estimators are tied if the
    difference is not significant. For each network, the table also gives the error of the silenced network,
    which has output weights of zero.

    For a dataset, the command writes evaluation.csv, figures of errors and convergence, and report.html.

    For logs, the command writes logs.csv and report.html. The row "level" of the table shows how far the log
    is from level. The report shows readings, attitudes and errors on one time axis.

    If a dataset or a log contains rotor speeds, imm and your own estimators can use them.

    Example: quadsim evaluate --data data/test.zarr --estimator mahony --estimator att-snn-loihi

    Example: quadsim evaluate --logs flight.ulg --estimator imm --rerun flight.rrd
    """
    from .conditions import Filters

    given = settings_of(set_, Filters)
    if (data is None) == (not logs):
        raise ValueError("give either --data or --logs")
    if (rerun or mcap) and len(logs or ()) != 1:
        raise ValueError("--rerun and --mcap need exactly one --logs")
    if logs:
        import numpy as np

        from scenarios.log_report.evaluate import evaluate_logs

        from ..pictures.timeline import viewer_files

        # of numbers that no sensor has, which are refused
        with alone(out), np.errstate(over="ignore", invalid="ignore"), viewer_files(rerun, mcap) as show:
            evaluate_logs(
                logs,
                out,
                estimator,
                given.tuning,
                given.vehicle,
                within_deg=within,
                mount=mount,
                force=force,
                show=show,
            )
        return
    if mount is not None:
        raise ValueError("--mount applies only to --logs, because a dataset is in body axes")
    assert data is not None
    from scenarios.report.evaluation import evaluate_dataset

    with alone(out):
        evaluate_dataset(data, out, estimator, given.tuning, given.vehicle, seed=seed)


def paper(
    out: Annotated[Path, typer.Option(help="Folder for the page, the figures and all intermediate results.")],
    only: Annotated[
        str | None,
        typer.Option(
            help="Parts to make, separated by commas, such as table1,fig5. The parts are table1, table2, "
            "fig3 to fig9, operations, loop, rate and minutes. Default: all parts."
        ),
    ] = None,
    preset: Annotated[
        str,
        typer.Option(
            help="quick: short flights and trainings, for a first look. full: as many flights and epochs as "
            "the paper used."
        ),
    ] = "quick",
    seed: Seed = 0,
    workers: Workers = None,
) -> None:
    """Reproduce every table and figure of the paper, and judge which of its claims hold in simulation.

    The paper is "Neuromorphic computing for attitude estimation onboard quadrotors" by Stroobants, Dupeyroux
    and de Croon (2022). The command generates flights, tunes filters, and trains and flies networks. All data
    is simulated. The command writes the results to paper.md.

    The preset quick takes some minutes on two cores and does not judge the claims. The preset full takes a
    night. Finished parts are stored in the folder, so the same command resumes a run that was stopped.

    Example: quadsim paper --out reports/paper --only table2,fig6
    """
    from paper.run import paper as make_paper

    with alone(out), progress_bar("paper", "stages") as bar:
        done = make_paper(out, only, preset, seed, workers, bar)
    rows = [(each.claim, each.verdict) for each in done.judged if each.verdict != "not judged"]
    if rows:
        print_table(rows)
    say(f"{done.page}: {done.headline}")
