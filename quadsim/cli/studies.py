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
        typer.Option(help="Dataset to score on; use flights that were not used for training or tuning."),
    ] = None,
    logs: Annotated[
        list[Path] | None,
        typer.Option(help="Log to score on, instead of --data; repeat the option to add more."),
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(help="A name, weights or your own file.py:Class; repeat for more. Default: all."),
    ] = None,
    within: Annotated[
        float,
        typer.Option(min=1, max=180, help="For logs: largest true inclination scored, in degrees."),
    ] = 45.0,
    mount: Mount = None,
    rerun: Rerun = None,
    mcap: Mcap = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Parameters of filters, as name=value: tuning (a shipped name or a file from quadsim tune; "
            "default: those of the vehicle) or vehicle (for ekf-drag: a shipped name or a TOML file; "
            "default: the dataset's vehicle; logs have no default). Repeat for more.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for table, figures and report.")] = Path(
        "reports/evaluate"
    ),
    force: Force = False,
    seed: Seed = 0,
) -> None:
    """Compare estimators on stored flights or logs: errors with confidence intervals, convergence, run time.

    Each estimator is compared with the best one flight by flight. Estimators are tied if the difference is
    not significant. For each network, the table also gives the error of the silenced network (output
    weights of zero).

    For a dataset, the command writes evaluation.csv, figures of errors and convergence, and report.html. For
    logs, it writes logs.csv, whose row "level" shows how far the log is from level, and report.html with
    readings, attitudes and errors on one time axis.

    If a dataset or a log contains rotor speeds, imm and your own estimators can use them.

    Example: quadsim evaluate --data data/test.zarr --estimator mahony --estimator att-snn-loihi

    Example: quadsim evaluate --logs flight.ulg --estimator imm --rerun flight.rrd
    """
    from .conditions import Filters

    given = settings_of(set_, Filters)
    if (data is None) == (not logs):
        raise ValueError("one of --data and --logs is required")
    if (rerun or mcap) and len(logs or ()) != 1:
        raise ValueError("--rerun and --mcap show one log: give one --logs")
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
        raise ValueError("--mount is of the IMU of --logs; a dataset is in body axes")
    assert data is not None
    from scenarios.report.evaluation import evaluate_dataset

    with alone(out):
        evaluate_dataset(data, out, estimator, given.tuning, given.vehicle, seed=seed)


def paper(
    out: Annotated[Path, typer.Option(help="Folder for the page, its figures and all intermediate results.")],
    only: Annotated[
        str | None,
        typer.Option(
            help="Parts to make, separated by commas, such as table1,fig5. Parts: table1, table2, fig3 to "
            "fig9, operations, loop, rate, minutes. Default: all."
        ),
    ] = None,
    preset: Annotated[
        str,
        typer.Option(help="quick: short flights and trainings, for a first look. full: the paper's sizes."),
    ] = "quick",
    seed: Seed = 0,
    workers: Workers = None,
) -> None:
    """Reproduce every table and figure of the paper, and judge which of its claims hold in simulation.

    The paper is Stroobants, Dupeyroux and de Croon (2022). All data is simulated: the command generates
    flights, tunes filters, and trains and flies networks. It writes paper.md with its figures.

    The preset quick takes some minutes on two cores and judges no claims; full takes a night. Finished
    parts are stored in the folder, so the same command resumes a run that was stopped.

    Example: quadsim paper --out reports/paper --only table2,fig6
    """
    from paper.run import paper as make_paper

    with alone(out), progress_bar("paper", "stages") as bar:
        done = make_paper(out, only, preset, seed, workers, bar)
    rows = [(each.claim, each.verdict) for each in done.judged if each.verdict != "not judged"]
    if rows:
        print_table(rows)
    say(f"{done.page}: {done.headline}")
