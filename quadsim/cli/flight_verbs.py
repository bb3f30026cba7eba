"""Commands that fly in closed loop: `fly`, `bench`, `demo`."""

import signal
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from ..runs.console import progress_bar, say
from ..runs.files import alone
from .options import OWN_CONTROLLER, ConditionFields, Duration, Mcap, Rerun, Seed, Workers, settings_of


def fly(
    scenario: Annotated[
        str,
        typer.Argument(
            help="A shipped scenario (see quadsim list scenarios), for example wind-gust, or a TOML file."
        ),
    ],
    estimator: Annotated[
        str | None,
        typer.Option(
            help="Estimator: a name (see quadsim list estimators), weights (.safetensors) or your own "
            "file.py:Class. Default: att-snn-loihi."
        ),
    ] = None,
    controller: Annotated[str, typer.Option(help=OWN_CONTROLLER)] = "cascaded",
    autopilot: Annotated[
        str | None,
        typer.Option(
            help="Firmware that replaces the estimator and the controller: betaflight (angle mode) or "
            "betaflight-rate (rate mode). The first flight compiles the firmware."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the results. Default: a folder in reports/ whose name contains the scenario, "
            "the estimator, and a vehicle, IMU or tuning given by --set."
        ),
    ] = None,
    duration: Duration = None,
    seeds: Annotated[int, typer.Option(min=1, max=10_000, help="Number of flights.")] = 1,
    set_: ConditionFields = None,
    seed: Seed = 0,
    video: Annotated[bool, typer.Option("--video", help="Write an MP4 of the first flight.")] = False,
    rerun: Rerun = None,
    mcap: Mcap = None,
) -> None:
    """Fly one scenario with attitude from one estimator; write a report and all samples as CSV.

    Example: quadsim fly wind-gust --estimator att-snn-loihi --video

    Example: quadsim fly figure-8 --estimator eskf --rerun flight.rrd --mcap flight.mcap

    Example: quadsim fly step --autopilot betaflight
    """
    from estimators.control.controller import CASCADED
    from quadsim.autopilot.flight import AUTOPILOTS
    from quadsim.config.toml import nearest
    from scenarios.bench.cell import FlightSettings
    from scenarios.bench.controllers import contender
    from scenarios.single_flight import file_name, fly_scenario
    from scenarios.verbs import warn

    from ..pictures.timeline import viewer_files
    from .conditions import FlightConditions

    if autopilot is None:
        estimator = contender(estimator or "att-snn-loihi", controller)
    elif autopilot not in AUTOPILOTS:
        raise ValueError(f"--autopilot {autopilot}: {nearest(autopilot, AUTOPILOTS)}")
    elif estimator or controller != CASCADED:
        raise ValueError(
            f"--autopilot {autopilot} has its own estimator and controller: omit --estimator and --controller"
        )
    else:
        estimator = autopilot
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # its folder and locks are removed
    given = settings_of(set_, FlightConditions)
    if autopilot and given.tuning:
        raise ValueError(f"--autopilot {autopilot} has its own estimator: omit --set tuning")
    parts = (scenario, estimator, *filter(None, (given.vehicle, given.imu, given.tuning)))
    folder = out or Path("reports") / "-".join(["fly", *map(file_name, parts)])
    try:
        with (
            alone(folder),
            viewer_files(rerun, mcap) as show,
            progress_bar("video", "frames") if video else nullcontext() as bar,
        ):
            done = fly_scenario(
                scenario,
                estimator,
                folder,
                FlightSettings(seeds, seed, given.rate, given.tuning),
                given.changes(duration),
                flight=given.flight,
                video=video,
                progress=bar,
                show=show,
            )
    except RuntimeError as error:  # no OpenGL for the video
        raise ValueError(str(error)) from error
    row = done.results.rows[0]
    if row.reason:
        raise ValueError(f"{scenario} could not be flown with {estimator}: {row.reason}")
    warn(done.results)
    for name, why in done.results.unranked.items():
        say(f"{name} {why}.")
    errors = "no error was measured"
    if row.error_deg is not None and row.attitude_deg is not None:
        errors = f"error {row.error_deg:.2f}°, attitude tracking error {row.attitude_deg:.2f}°"
    flights = "flight" if row.flights == 1 else "flights"
    say(f"{done.report}: {row.crashes} of {row.flights} {flights} crashed, {errors}")


def bench(
    out: Annotated[Path, typer.Option(help="Folder for the report and the tables.")] = Path("reports/bench"),
    task: Annotated[
        str | None,
        typer.Option(
            help="Run a benchmark task instead of an experiment: attitude-1, or your own TOML file. The "
            "command writes an entry.json for each --estimator, and a leaderboard. Use --set broad=FOLDER to "
            "include your copy of the BROAD recordings."
        ),
    ] = None,
    experiment: Annotated[
        str,
        typer.Option(
            help="suite: all shipped scenarios. axes: combinations of initial attitude, motion, drag, "
            "airframe and IMU. held-out: scenarios drawn with held-out seeds. breaking-points: disturbances "
            "at increasing levels. You can also give your own TOML file."
        ),
    ] = "suite",
    scenario: Annotated[
        list[str] | None,
        typer.Option(
            help="Scenario to fly. Repeat the option to add more. Default: the scenarios of the experiment."
        ),
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            help="Estimator: a name, weights (.safetensors) or your own file.py:Class. Repeat the option to "
            "add more. Default: all estimators except ukf-filterpy, which is slow, and att-snn, which gives "
            "the same results as att-snn-loihi."
        ),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            help=f"{OWN_CONTROLLER} Repeat the option to add more; every estimator flies with each "
            "controller."
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(min=1, max=10_000, help="Number of flights in each cell. Default: the experiment's."),
    ] = None,
    duration: Duration = None,
    set_: ConditionFields = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of all random numbers. Default: the experiment's.")
    ] = None,
    workers: Workers = None,
) -> None:
    """Fly scenarios × estimators × seeds in closed loop, and report which estimator is best.

    A cell is one scenario with one estimator. Finished cells are stored, so the same command resumes a run
    that was stopped. If a cell cannot run, results.csv gives the reason. The exit code is 2 only if no cell
    ran. The table flights.parquet has one row for each flight.

    Example: quadsim bench --scenario hover --scenario wind-gust --estimator att-snn-loihi --estimator mahony

    Example: quadsim bench --scenario step --estimator eskf --controller cascaded --controller mine.py:make

    Example: quadsim bench --experiment axes --estimator truth --estimator imm --out reports/axes

    Example: quadsim bench --task attitude-1 --estimator mine.py:Mine --out reports/attitude-1
    """
    from scenarios.verbs import run_bench, run_entries

    from .conditions import Conditions, Recordings

    if task is not None:
        others = {
            "--scenario": scenario,
            "--controller": controller,
            "--seeds": seeds,
            "--duration": duration,
        }
        others |= {"--seed": seed, "--experiment": experiment != "suite"}
        for name, value in others.items():
            if value:
                raise ValueError(f"{name} cannot be combined with --task, because the task defines it")
        if not estimator:
            raise ValueError("--task: give at least one --estimator")
        run_entries(out, task, estimator, settings_of(set_, Recordings).broad, workers)
        return
    given = settings_of(set_, Conditions)
    run_bench(
        out, experiment, scenario, estimator, controller or [], given.changes(duration),
        seeds=seeds, seed=seed, rate_hz=given.rate, tuning=given.tuning, workers=workers,
    )  # fmt: skip


def demo(
    out: Annotated[Path, typer.Option(help="Folder for all results.")] = Path("reports/demo"),
    flights: Annotated[int, typer.Option(min=1, help="Number of flights to generate.")] = 6,
    seeds: Annotated[
        int, typer.Option(min=1, help="Number of flights of each estimator in each scenario.")
    ] = 5,
    seed: Seed = 0,
    workers: Workers = None,
) -> None:
    """Run a small demonstration: generate flights, score estimators, fly scenarios, and write a report."""
    from scenarios.verbs import demo as run_demo

    run_demo(out, flights, seeds, seed, workers)
