"""Verbs that close the loop: `fly`, `bench`, `demo`."""

from pathlib import Path
from typing import Annotated

import typer

from ..runs.console import output as console
from ..runs.files import alone
from .options import (
    OWN_CONTROLLER,
    ConditionFields,
    Pool,
    Seed,
    Workers,
    conditions_of,
)


def fly(
    scenario: Annotated[
        str, typer.Argument(help="A shipped scenario, for example wind-gust, or a TOML file.")
    ],
    estimator: Annotated[
        str,
        typer.Option(
            help="Estimator whose attitude is used: a name, weights (.safetensors) or your own file.py:Class."
        ),
    ] = "att-snn-loihi",
    controller: Annotated[str, typer.Option(help=f"Attitude controller: {OWN_CONTROLLER}.")] = "cascaded",
    out: Annotated[
        Path | None,
        typer.Option(help="Folder; reports/fly-SCENARIO-ESTIMATOR when left out, and the other choices."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.1, help="Length in seconds, in place of the scenario's.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=10_000, help="Number of flights.")] = 1,
    set_: ConditionFields = None,
    seed: Seed = 0,
    flight: Annotated[
        int,
        typer.Option(
            min=0, max=9999, help="Number of the first flight, as in the flights.parquet of quadsim bench."
        ),
    ] = 0,
    video: Annotated[bool, typer.Option("--video", help="Make an MP4 of the first flight.")] = False,
    view: Annotated[bool, typer.Option("--view", help="Show the first flight in MuJoCo's viewer.")] = False,
) -> None:
    """Fly one scenario with attitude from one estimator: report, every sample as CSV, video.

    Example: quadsim fly wind-gust --estimator att-snn-loihi --video
    """
    from scenarios.bench.cell import FlightSettings
    from scenarios.bench.controllers import contender
    from scenarios.single_flight import file_name, fly_scenario
    from scenarios.verbs import warn

    estimator = contender(estimator, controller)
    given = conditions_of(set_)
    parts = (scenario, estimator, *filter(None, (given.vehicle, given.imu, given.tuning)))
    folder = out or Path("reports") / "-".join(["fly", *map(file_name, parts)])
    try:
        with alone(folder):
            done = fly_scenario(
                scenario,
                estimator,
                folder,
                FlightSettings(seeds, seed, given.rate, given.tuning),
                given.changes(duration),
                flight=flight,
                video=video,
                view=view,
            )
    except RuntimeError as error:  # no OpenGL for the video, no screen for the view
        raise ValueError(str(error)) from error
    row = done.results.rows[0]
    if row.reason:
        raise ValueError(f"{scenario} did not run with {estimator}: {row.reason}")
    warn(done.results)
    for name, why in done.results.unranked.items():
        console.print(f"{name} {why}.", soft_wrap=True, markup=False)
    errors = "so there is no error to report"
    if row.error_deg is not None and row.attitude_deg is not None:
        errors = f"error {row.error_deg:.2f}°, attitude tracking error {row.attitude_deg:.2f}°"
    console.print(
        f"{done.report}: {row.crashes} of {row.flights} crashed, {errors}", soft_wrap=True, markup=False
    )


def bench(
    out: Annotated[Path, typer.Option(help="Folder of report and tables.")] = Path("reports/bench"),
    experiment: Annotated[
        str,
        typer.Option(
            help="What is flown: suite, every scenario; axes, with initial attitude, motion, drag, airframe "
            "and IMU varied; held-out, scenarios drawn with held-out seeds; breaking-points, the least "
            "disturbance with a crash; or a TOML file."
        ),
    ] = "suite",
    scenario: Annotated[
        list[str] | None,
        typer.Option(help="Scenario, in place of the experiment's; give it again for more."),
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            help="Estimator: a name, weights (.safetensors) or your own file.py:Class; again for more. All "
            "but the slow ukf-filterpy if left out."
        ),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Attitude controller: {OWN_CONTROLLER}; again for more, each with every estimator."
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(min=1, max=10_000, help="Flights in each cell, in place of the experiment's."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.1, help="Length in seconds, in place of the scenarios'.")
    ] = None,
    set_: ConditionFields = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of everything random.")] = None,
    workers: Pool = None,
) -> None:
    """Fly scenarios × estimators × seeds in closed loop, and report which estimator is best.

    Finished cells are stored: the same command resumes a killed run. The exit code is 2 only where no cell
    ran at all; results.csv has the reason of each that did not. flights.parquet has a row for each flight,
    with its levels of every condition.

    On several machines (pip install 'quadsim[cluster]' on each): start `dask scheduler` on one, then `dask
    worker tcp://HOST:8786 --nworkers auto --nthreads 1` on each, and give `--workers tcp://HOST:8786` here.
    Weights and files are read by the workers: the same paths must hold there.

    Example: quadsim bench --scenario hover --scenario wind-gust --estimator att-snn-loihi --estimator mahony

    Example: quadsim bench --scenario step --estimator eskf --controller cascaded --controller mine.py:make

    Example: quadsim bench --experiment axes --estimator truth --estimator imm --out reports/axes

    Example: quadsim bench --workers tcp://127.0.0.1:8786 --seeds 100
    """
    from scenarios.verbs import run_bench

    given = conditions_of(set_)
    run_bench(
        out, experiment, scenario, estimator, controller or [], given.changes(duration),
        seeds=seeds, seed=seed, rate_hz=given.rate, tuning=given.tuning, workers=workers,
    )  # fmt: skip


def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything.")] = Path("reports/demo"),
    flights: Annotated[int, typer.Option(min=1, help="Flights to generate.")] = 6,
    seeds: Annotated[int, typer.Option(min=1, help="Flights of each estimator in each scenario.")] = 5,
    seed: Seed = 0,
    workers: Workers = None,
) -> None:
    """Run it all in small: generate flights, score estimators on them, close the loop, write the report."""
    from scenarios.verbs import demo as run_demo

    run_demo(out, flights=flights, seeds=seeds, seed=seed, workers=workers)
