"""Verbs that compare: `evaluate` on recorded flights and logs, `paper` for all of the paper's results."""

from pathlib import Path
from typing import Annotated

import typer

from ..runs.console import output as console
from ..runs.console import progress_bar
from ..runs.files import save_figure
from .options import Seed, Workers


def evaluate(
    data: Annotated[
        Path | None, typer.Option(help="Dataset of flights that were not tuned or trained on.")
    ] = None,
    logs: Annotated[
        list[Path] | None, typer.Option(help="Real log in place of --data; give it again for more.")
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(help="Estimator: a name or your module:Class; again for more. All if left out."),
    ] = None,
    weights: Annotated[
        list[str] | None, typer.Option(help="Weights file to score too, named by its path; again for more.")
    ] = None,
    within: Annotated[
        float, typer.Option(min=1, max=180, help="With --logs: largest true inclination scored, in °.")
    ] = 45.0,
    axes: Annotated[
        str | None, typer.Option(help='With --logs: body x, y, z as its axes ("z,-y,x").')
    ] = None,
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
    slow_flights: Annotated[
        int, typer.Option(min=1, help="Flights for filterpy's filters, hundreds of times as slow as others.")
    ] = 4,
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
    zero. Writes evaluation.csv, the violins, the error over time and the convergence as PNG, and report.html;
    of real logs logs.csv and a picture each, with a row "level" that shows how hard the log is.

    Example: quadsim evaluate --data data/test.zarr --estimator mahony --estimator att-snn-loihi
    """
    if (data is None) == (not logs):
        raise ValueError("one of --data and --logs is wanted")
    if logs:
        from scenarios.report.logs import evaluate_logs

        evaluate_logs(logs, estimator, weights or [], within, axes, tuning, vehicle, out, force)
        return
    if axes is not None:
        raise ValueError("--axes turns the sensors of --logs; a dataset has body axes")
    assert data is not None
    import estimators
    from estimators.evaluation import figures
    from estimators.evaluation.comparison import evaluate as evaluate_estimators
    from estimators.evaluation.flights import imu_of, vehicle_of
    from estimators.registry import needs_vehicle, tuned_elsewhere
    from scenarios.report.logs import made_of
    from scenarios.report.page import write_report
    from scenarios.report.terminal import (
        EVALUATION_METHOD,
        evaluation_columns,
        evaluation_notes,
        evaluation_table,
    )

    from ..dataset.reading import open_dataset

    flown = open_dataset(data)
    airframe = vehicle or vehicle_of(flown)
    rate_hz = float(flown.attrs["rate_hz"])
    every = [name for name in estimators.names() if airframe is not None or not needs_vehicle(name)]
    made = made_of(estimator or every, weights or [], rate_hz, tuning, airframe, imu_of(flown))
    with progress_bar("evaluate", "runs") as bar:
        done = evaluate_estimators(
            flown,
            made,
            slow_flights=slow_flights,
            seed=seed,
            progress=bar,
        )
    done.write_csv(out / "evaluation.csv")
    pictures = {}
    for name, draw in (
        ("violins", figures.violins),
        ("error-over-time", figures.error_over_time),
        ("convergence", figures.settling),
    ):
        pictures[name] = out / f"{name}.png"
        save_figure(pictures[name], draw(done), dpi=130)
    caption = f"{flown.sizes['flight']} flights of {data}, without a loop."
    notes = [*evaluation_notes(done.rows), *tuned_elsewhere(made, tuning, airframe, imu_of(flown))]
    page = write_report(
        out / "report.html",
        title="Attitude estimators on recorded flights",
        offline=evaluation_columns(done.rows),
        offline_caption=" ".join([caption, *notes]),
        footer=EVALUATION_METHOD,
        pictures=pictures,
        csv=["evaluation.csv"],
    )
    console.print(evaluation_table(done.rows, caption))
    for note in notes:
        console.print(note, soft_wrap=True)
    flying = [row for row in done.rows if row.initial == "unknown" and row.estimator != "truth"]
    if not flying:
        console.print(f"{page}", soft_wrap=True)
        return
    best = min(flying, key=lambda row: row.behind_deg)
    tied = [row.estimator for row in flying if row.tied and row is not best and row.flights == best.flights]
    console.print(
        f"{page}: the smallest error from an unknown start is {best.estimator}'s, {best.mean_deg:.2f}°"
        + (f", not significantly different from {', '.join(tied)}" if tied else ""),
        soft_wrap=True,
    )


def paper(
    out: Annotated[Path, typer.Option(help="Folder for the pages and for all that they come from.")],
    only: Annotated[
        str | None,
        typer.Option(
            help="Some of it, such as table1,fig5: table1 table2 fig3 to fig9 flops loop rate size minutes."
        ),
    ] = None,
    preset: Annotated[
        str, typer.Option(help="quick: short flights and trainings; full: the paper's sizes.")
    ] = "quick",
    seed: Seed = 0,
    workers: Workers = None,
) -> None:
    """Make every table and figure of the paper from nothing, and judge which of its claims hold here.

    Stroobants, Dupeyroux and de Croon (2022), without a Loihi, a quadrotor or a motion-capture hall: flights
    are generated, filters tuned, networks trained and flown. Writes paper.md with its figures, and a page
    each on sample rates, network sizes and minutes of flight.

    quick takes some minutes on two cores, full about an hour or two. Every part is kept in the folder: the
    same command goes on where a killed one stopped, and makes nothing twice.

    Example: quadsim paper --out reports/paper --only table2,fig6
    """
    from paper.run import paper as make_paper
    from scenarios.report.terminal import plain_table

    with progress_bar("paper", "s of work") as bar:
        done = make_paper(out, only, preset, seed, workers, bar)
    rows = [(each.claim, each.verdict) for each in done.judged if each.verdict != "not judged"]
    if rows:
        console.print(plain_table(rows))
    console.print(f"{done.page}: {done.headline}", soft_wrap=True)
