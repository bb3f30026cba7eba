"""Verbs that close the loop: `fly`, `bench`, `demo`."""

from pathlib import Path
from typing import Annotated

import typer

from ..runs.console import output as console
from ..runs.console import pool_of, progress_bar
from ..runs.files import alone
from ..runs.record import recorded
from .options import (
    OWN_CONTROLLER,
    ConditionFields,
    Pool,
    Seed,
    Workers,
    conditions_of,
    headline,
    warn_of,
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
            min=0, max=9999, help="Number of the first flight, as in the flights.csv of quadsim bench."
        ),
    ] = 0,
    video: Annotated[bool, typer.Option("--video", help="Make an MP4 of the first flight.")] = False,
    view: Annotated[bool, typer.Option("--view", help="Show the first flight in MuJoCo's viewer.")] = False,
) -> None:
    """Fly one scenario with attitude from one estimator: report, every sample as CSV, video.

    Example: quadsim fly wind-gust --estimator att-snn-loihi --video
    """
    from scenarios.bench.cell import file_name
    from scenarios.bench.controllers import contender
    from scenarios.bench.settings import FlightSettings, ScenarioChanges
    from scenarios.single_flight import fly_scenario

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
                ScenarioChanges(duration, given.vehicle, given.imu, given.external, given.engine),
                flight=flight,
                video=video,
                view=view,
            )
    except RuntimeError as error:  # no OpenGL for the video, no screen for the view
        raise ValueError(str(error)) from error
    row = done.results.rows[0]
    if row.reason:
        raise ValueError(f"{scenario} did not run with {estimator}: {row.reason}")
    warn_of(done.results)
    for name, why in done.results.unranked.items():
        console.print(f"{name} {why}.", soft_wrap=True, markup=False)
    errors = "so there is no error to report"
    if row.error_deg is not None and row.attitude_deg is not None:
        errors = f"error {row.error_deg:.2f}°, attitude tracking error {row.attitude_deg:.2f}°"
    console.print(
        f"{done.report}: {row.crashes} of {row.flights} crashed, {errors}", soft_wrap=True, markup=False
    )


def bench(
    out: Annotated[Path, typer.Option(help="Folder for report.html, results.csv and flights.csv.")] = Path(
        "reports/bench"
    ),
    scenario: Annotated[
        list[str] | None, typer.Option(help="Scenario; give it again for more. All if left out.")
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
        typer.Option(
            min=1, max=10_000, help="Flights in each cell; 10 when left out, 4 with --axes or --held-out."
        ),
    ] = None,
    axes: Annotated[
        bool,
        typer.Option(
            "--axes",
            help="Vary the initial attitude, motion, drag, airframe and IMU too: a designed fraction of all "
            "combinations, and the effect of each.",
        ),
    ] = False,
    full: Annotated[bool, typer.Option("--full", help="With --axes: every combination.")] = False,
    held_out: Annotated[
        bool,
        typer.Option(
            "--held-out",
            help="Fly the held-out suite: scenarios that are drawn, by seeds that nothing learnt from.",
        ),
    ] = False,
    duration: Annotated[
        float | None, typer.Option(min=0.1, help="Length in seconds, in place of the scenarios'.")
    ] = None,
    breaking_point: Annotated[
        list[str] | None,
        typer.Option(
            help="Search breaking points of each estimator too: wind, bias, dropout; again for more, or all."
        ),
    ] = None,
    set_: ConditionFields = None,
    seed: Seed = 0,
    workers: Pool = None,
) -> None:
    """Fly scenarios × estimators × seeds in closed loop, and report which estimator is best.

    Finished cells are stored: the same command resumes a killed run. The exit code is 2 only where no cell
    ran at all; results.csv has the reason of each that did not. Breaking points are
    searched by bisection, with the same estimators and seeds, and join the report.

    With --axes or --held-out, the report, effects.csv and axes.png have the error and the crashes at each
    level of each axis, and the verdict has a sentence for each condition: the airframe known, and not.

    On several machines (pip install 'quadsim[cluster]' on each): start `dask scheduler` on one, then `dask
    worker tcp://HOST:8786 --nworkers auto --nthreads 1` on each, and give `--workers tcp://HOST:8786` here.
    Weights and files are read by the workers: the same paths must hold there.

    Example: quadsim bench --scenario hover --scenario wind-gust --estimator att-snn-loihi --estimator mahony

    Example: quadsim bench --scenario step --estimator eskf --controller cascaded --controller mine.py:make

    Example: quadsim bench --axes --estimator truth --estimator imm --estimator vqf --out reports/axes

    Example: quadsim bench --workers tcp://127.0.0.1:8786 --seeds 100
    """
    import estimators
    from scenarios.bench import axes as axes_of
    from scenarios.bench.breaking import breaking_points, chosen
    from scenarios.bench.controllers import contenders
    from scenarios.bench.cost import cost_of
    from scenarios.bench.held_out import suite as draw
    from scenarios.bench.runner import bench as run_bench
    from scenarios.bench.runner import shown_once
    from scenarios.bench.settings import FlightSettings, ScenarioChanges
    from scenarios.bench.verdict import on_truth
    from scenarios.demo import SLOW
    from scenarios.report.publish import publish, publish_axes
    from scenarios.report.terminal import axes_tables, breaking_table, closed_loop_table, controllers_table

    from ..flight.scenario import scenario_names
    from ..held_out import load_held_out, releases

    names = contenders(
        estimator or [name for name in estimators.names() if name not in SLOW], controller or []
    )
    searched = chosen(breaking_point or [], duration)
    given = conditions_of(set_)
    if full and not axes:
        raise ValueError("--full is for --axes: give both")
    if (axes or held_out) and (given.vehicle or given.imu or searched):
        raise ValueError("--axes and --held-out vary vehicle and IMU: leave these and --breaking-point out")
    if held_out and (axes or scenario or seed):
        raise ValueError("--held-out has its own scenarios and seed: leave --axes, --scenario and --seed out")
    if (axes or held_out) and (len(controller or []) > 1 or all(map(on_truth, names))):
        raise ValueError(
            "--axes and --held-out compare estimators: give one besides truth, and one controller at most"
        )
    changes = ScenarioChanges(duration, given.vehicle, given.imu, given.external, given.engine)
    combinations, flown = [], scenario or scenario_names()
    if axes:
        combinations = axes_of.design(scenario or axes_of.SCENARIOS, full=full)
        flown = {each.name: axes_of.scenario_of(each) for each in combinations}
        settings = FlightSettings(seeds or 4, seed, given.rate, given.tuning)
    elif held_out:
        suite = load_held_out(releases()[-1])
        drawn = draw(suite)
        combinations = [combination for combination, _ in drawn.values()]
        flown = {name: each for name, (_, each) in drawn.items()}
        settings = FlightSettings(seeds or suite.flights, suite.seed, given.rate, given.tuning)
    else:
        settings = FlightSettings(seeds or 10, seed, given.rate, given.tuning)
    points = []
    if not estimator:
        slow = ", ".join(SLOW)
        console.print(f"Without {slow}, slower than all others together; --estimator NAME chooses.")
    with alone(out):
        with recorded(out), pool_of(workers) as (count, executor):
            with progress_bar("fly", "cells") as progress:
                results = run_bench(
                    flown, names, out, settings, changes,
                    workers=count, executor=executor, progress=progress,
                )  # fmt: skip
            if searched:
                with progress_bar("break", "points") as progress:
                    points = breaking_points(
                        searched, names, out, settings, changes,
                        workers=count, executor=executor, progress=progress,
                    )  # fmt: skip
        failed = all(cell.reason for cell in results.cells)
        page, note = (
            (publish_axes(out, results, combinations), "")
            if combinations and not failed
            else publish(out, results, points)
        )
    if combinations:
        console.print(*axes_tables(axes_of.effects(combinations, results)))
        for line in axes_of.advice(combinations, results):
            console.print(line, soft_wrap=True, markup=False)
    else:
        console.print(closed_loop_table(results))
        if (controllers := controllers_table(results)) is not None:
            console.print(controllers)
    if points:
        console.print(breaking_table(points))
    for line in filter(None, (note, shown_once(results)[1], f"{cost_of(results)}.")):
        console.print(line, soft_wrap=True, markup=False)
    if not combinations:  # whose point are vehicles and IMUs that nobody tuned for
        warn_of(results)
    console.print(headline(page, results, combinations), soft_wrap=True, markup=False)
    if failed:
        raise ValueError(f"no cell ran; {results.cells[0].estimator}: {results.cells[0].reason}")


def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything.")] = Path("reports/demo"),
    flights: Annotated[int, typer.Option(min=1, help="Flights to generate.")] = 6,
    seeds: Annotated[int, typer.Option(min=1, help="Flights of each estimator in each scenario.")] = 5,
    seed: Seed = 0,
    workers: Workers = None,
) -> None:
    """Run it all in small: generate flights, score estimators on them, close the loop, write the report."""
    from scenarios.demo import demo as run_demo
    from scenarios.report.terminal import closed_loop_table, offline_table

    with alone(out):
        done = run_demo(out, flights=flights, seeds=seeds, seed=seed, workers=workers, stage=progress_bar)
    console.print(offline_table(done.offline))
    console.print(closed_loop_table(done.results))
    if done.note:
        console.print(done.note, soft_wrap=True)
    console.print(headline(done.report, done.results), soft_wrap=True, markup=False)
