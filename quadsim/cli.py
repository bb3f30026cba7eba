"""The command line. Each verb is thin: it parses, calls one function of the library, and says what came out.

This is the only module of `quadsim` that imports the packages above it: inside each verb, so that `--help` is
fast.
"""

import logging
import math
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console
from rich.table import Table

from .cli_logs import app as logs_app
from .console import Bar, executor_of, progress_bar
from .console import output as console

if TYPE_CHECKING:
    from training.config import TrainConfig

app = typer.Typer(
    name="quadsim",
    help="Fly a MuJoCo quadrotor on spiking, learned and classical attitude estimators: see which to trust.",
    epilog="Start here: quadsim demo --out reports/demo",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
dataset_app = typer.Typer(help="Look at a dataset, check it, plot it.", no_args_is_help=True)
app.add_typer(dataset_app, name="dataset")
app.add_typer(logs_app, name="logs")

Initial = Literal["unknown", "known"]
Search = Literal["swarm", "evolution"]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Worker processes; one per CPU when left out.")]
Preset = Annotated[
    str,
    typer.Option(
        help="paper: its recipe to the letter; best: the one to use; robust: rough sensors; tune: logs."
    ),
]
Fields = Annotated[
    list[str] | None,
    typer.Option("--set", help="Any other field of the training, as name=value; an unknown one lists them."),
]
Rate = Annotated[float, typer.Option(min=50, max=2000, help="Samples per second.")]


@app.command()
def generate(
    out: Annotated[Path, typer.Option(help="Where the dataset goes, for example data/train.zarr.")],
    flights: Annotated[int, typer.Option(min=1, help="Number of flights.")] = 35,
    duration: Annotated[float, typer.Option(min=0.1, help="Length of each flight in seconds.")] = 100.0,
    recipe: Annotated[
        str, typer.Option(help="What is flown: a shipped recipe or a TOML file.")
    ] = "hummingbird",
    vehicle: Annotated[
        str | None, typer.Option(help="Another vehicle: a shipped name or a TOML file.")
    ] = None,
    imu: Annotated[str | None, typer.Option(help="Another IMU: a shipped name or a TOML file.")] = None,
    rate: Rate = 200.0,
    seed: Seed = 0,
    workers: Workers = None,
    cluster: Annotated[str | None, typer.Option(help="Address of a Dask scheduler to run on.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what is at --out.")] = False,
) -> None:
    """Generate labelled synthetic flights: IMU samples and everything that was true.

    The defaults are the paper's size, 35 flights of 100 s at 200 Hz, and take some ten seconds. A killed run
    goes on where it stopped when the same command is given again; the number of workers changes nothing.

    Example: quadsim generate --flights 4 --duration 20 --out data/small.zarr
    """
    from .dataset import dataset_info
    from .dataset import generate as generate_dataset
    from .recipe import flight_config, load_recipe

    changes = {name: value for name, value in {"vehicle": vehicle, "imu": imu}.items() if value is not None}
    config = flight_config(load_recipe(recipe).model_copy(update=changes))
    with executor_of(cluster) as executor, progress_bar("generate", "flights") as progress:
        path = generate_dataset(
            config,
            flights,
            duration,
            out,
            seed=seed,
            rate_hz=rate,
            workers=workers,
            executor=executor,
            progress=progress,
            overwrite=overwrite,
        )
    info = dataset_info(path)
    console.print(
        f"{path}: {info['flights']} flights of {info['duration_s']:g} s at {info['rate_hz']:g} Hz, "
        f"roll SD {info['roll_sd_deg']:.1f}°, pitch SD {info['pitch_sd_deg']:.1f}°, "
        f"largest tilt {info['max_tilt_deg']:.0f}°, {info['size_MB']:.1f} MB",
        soft_wrap=True,
    )


@dataset_app.command("info")
def dataset_info_verb(path: Annotated[Path, typer.Argument(help="A dataset.")]) -> None:
    """Say what a dataset holds."""
    from .dataset import dataset_info

    info = dataset_info(path)
    table = Table(show_header=False)
    for key, value in info.items():
        if key != "config":
            table.add_row(key, f"{value:.3f}" if isinstance(value, float) else str(value))
    console.print(table)


@dataset_app.command("verify")
def dataset_verify(path: Annotated[Path, typer.Argument(help="A dataset.")]) -> None:
    """Recompute the checksums and look for numbers that are not finite."""
    from .dataset import verify

    with progress_bar("verify", "flights") as progress:
        total = verify(path, progress)
    console.print(f"{path}: all {total} flights are whole", soft_wrap=True)


@dataset_app.command("plot")
def dataset_plot(
    path: Annotated[Path, typer.Argument(help="A dataset.")],
    out: Annotated[Path, typer.Option(help="Where the picture goes.")] = Path("dataset.png"),
) -> None:
    """Draw the distributions of sensors and attitude (the paper's Fig. 3) and one flight."""
    from .figures import plot

    plot(path, out)
    console.print(f"{out}", soft_wrap=True)


@app.command()
def design(
    vehicle: Annotated[str, typer.Option(help="A shipped vehicle or a TOML file.")] = "hummingbird",
    rate: Rate = 200.0,
    delay: Annotated[
        float, typer.Option(min=0, help="Delay of the attitude estimate in milliseconds.")
    ] = 15.0,
    out: Annotated[
        Path | None, typer.Option(help="Picture of what other delays would cost, for example loop.png.")
    ] = None,
) -> None:
    """Design the controller's gains from phase margins, and print them with the margins they leave.

    Paste the gains into the vehicle's TOML file; a file without them has them designed when first needed.
    With --out, the attitude loop with these gains is shown at other delays of the estimator: margins,
    disturbance rejection, and steps as flown.
    """
    from .design import design as design_gains
    from .design import loop_margins
    from .vehicle import load_vehicle

    airframe = load_vehicle(vehicle)
    gains = design_gains(airframe, rate, delay / 1e3)
    table = Table("loop", "crossover, rad/s", "phase margin, °", "gain margin, dB", "delay margin, ms")
    for name, m in loop_margins(airframe, gains, rate, delay / 1e3).items():
        table.add_row(
            name, f"{m.crossover:.2f}", f"{m.phase_deg:.1f}", f"{m.gain_db:.1f}", f"{m.delay_ms:.0f}"
        )
    console.print(f"{vehicle}, {rate:g} Hz, estimator delay {delay:g} ms, rotor lag included")
    console.print(table)
    console.print("\\[controller]")
    for name, value in gains.model_dump().items():
        console.print(f"{name} = {value:.4g}", highlight=False)
    if out:
        from . import loops

        found = loops.responses(airframe, gains, rate)
        rows = loops.table(found)
        costs = Table(*rows[0], title="The attitude loop with these gains at other delays of the estimator")
        for row in rows:
            costs.add_row(*row.values())
        console.print(costs)
        title = f"{vehicle}, gains designed for {delay:g} ms"
        console.print(f"{loops.save(found, out, rate, title)}", soft_wrap=True)


@app.command()
def export(
    source: Annotated[
        Path, typer.Argument(help="A dataset; or weights: a file of them, or att-snn or att-rnn, which ship.")
    ],
    out: Annotated[Path, typer.Option(help="What to write; it must not exist yet.")],
    format: Annotated[
        str,
        typer.Option(
            help="Of a dataset: netcdf, parquet, csv (EuRoC folders) or rosbag2. "
            "Of weights: nir, c99 (header and source) or onnx (att-rnn)."
        ),
    ],
) -> None:
    """Write a dataset or a trained network in a format of other tools.

    Example: quadsim export att-snn --format c99 --out firmware/att_snn
    """
    from estimators.weights_export import FORMATS, export_weights

    from .export import export as export_dataset

    if format in FORMATS:
        export_weights(source, out, format)
    else:
        with progress_bar("export", "flights") as progress:
            export_dataset(source, out, format, progress)
    console.print(f"{out}: {source} as {format}", soft_wrap=True)


@app.command()
def train(
    data: Annotated[
        list[Path],
        typer.Option(
            "--data", "--domain", help="Dataset to train on; again for another domain, to mix them."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the run, for example runs/snn.")],
    model: Annotated[str, typer.Option(help="att-snn or att-rnn.")] = "att-snn",
    preset: Preset = "paper",
    validation: Annotated[
        list[Path] | None,
        typer.Option(help="Dataset to choose the best epoch by; else part of --data."),
    ] = None,
    init: Annotated[
        str | None, typer.Option(help="Weights to go on from: a shipped name, such as att-snn, or a file.")
    ] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="Most epochs, instead of the preset's.")] = None,
    threads: Annotated[int, typer.Option(min=1, help="Threads that share a batch.")] = 1,
    set_: Fields = None,
    seed: Seed = 0,
) -> None:
    """Train Att-SNN as the chip will run it, or its non-spiking twin Att-RNN.

    Writes the best weights, a row of losses per epoch and their plot; Ctrl-C keeps the best weights, and the
    same command goes on where a run stopped. The paper's recipe hardly learns; use --preset best.

    Example: quadsim train --preset best --data data/train.zarr --validation data/val.zarr --out runs/snn
    """
    from training.loop import Epoch
    from training.loop import train as train_network

    choices: dict[str, object] = dict(pair_of(text) for text in set_ or [])
    if epochs is not None:
        choices["epochs"] = epochs
    if init is not None:
        choices["init"] = init
    if validation:
        choices["validation"] = tuple(map(str, validation))
    with progress_bar(f"train {model}", "epochs") as bar:

        def progress(epoch: Epoch, config: "TrainConfig") -> None:
            bar(epoch.epoch + 1, config.epochs)
            console.print(
                f"epoch {epoch.epoch}: training RMSE {epoch.train_rmse_deg:.2f}°, "
                f"validation {epoch.val_error_deg:.2f}°, spike rates {epoch.rate_encoding:.3f} "
                f"{epoch.rate_hidden:.3f}, {time_left(epoch.seconds, epoch.epoch + 1, config.epochs)} left",
                highlight=False,
            )

        result = train_network(
            model,
            tuple(map(str, data)),
            out,
            preset,
            progress,
            seed=seed,
            threads=threads,
            **choices,
        )
    console.print(
        f"{result.weights}: validation error {result.best.val_error_deg:.2f}° at epoch {result.best.epoch}; "
        f"{result.reason}",
        soft_wrap=True,
    )
    if result.before_deg is not None:
        helped = "it helped" if result.helped else "it did not help, keep the weights you had"
        console.print(
            f"before {result.before_deg:.2f}°, after {result.best.val_error_deg:.2f}°: {helped}",
            soft_wrap=True,
        )


@app.command()
def kfold(
    data: Annotated[
        list[Path], typer.Option("--data", "--domain", help="Dataset of a domain; again for another domain.")
    ],
    out: Annotated[Path, typer.Option(help="Folder of the runs and the results.")],
    model: Annotated[list[str] | None, typer.Option(help="att-snn or att-rnn; again for both.")] = None,
    preset: Preset = "paper",
    folds: Annotated[int, typer.Option(min=2, help="Parts that each domain's flights are dealt into.")] = 5,
    epochs: Annotated[int | None, typer.Option(min=1, help="Most epochs, instead of the preset's.")] = None,
    set_: Fields = None,
    seed: Seed = 0,
    workers: Workers = None,
    cluster: Annotated[str | None, typer.Option(help="Address of a Dask scheduler to run on.")] = None,
) -> None:
    """Cross-validate the training: k folds in each domain, each also tested on the other domains.

    Writes the paper's Table 1 (table1.csv), every fold (kfold.csv, kfold.png), and a run folder for each.
    Folds run side by side; the same command goes on where a killed one stopped.

    Example: quadsim kfold --domain data/train.zarr --domain data/train-px4.zarr --out runs/kfold
    """
    from training.kfold import kfold as run_folds
    from training.table1 import TEST, table, terminal_table

    choices: dict[str, object] = dict(pair_of(text) for text in set_ or [])
    if epochs is not None:
        choices["epochs"] = epochs
    with executor_of(cluster) as executor, progress_bar("folds", "epochs") as progress:
        scores = run_folds(
            data,
            out,
            model or ["att-snn"],
            preset,
            folds,
            workers,
            executor,
            progress,
            seed=seed,
            **choices,
        )
    cells = table(scores)
    console.print(terminal_table(cells))
    held_out = [cell for cell in cells if cell.tested_on == TEST]
    best = min(held_out, key=lambda cell: cell.mean_deg)
    console.print(
        f"{out / 'table1.csv'}: {best.model} on unseen flights of {best.trained_on}: "
        f"{best.mean_deg:.2f} ± {best.sd_deg:.2f}° over {best.folds} folds",
        soft_wrap=True,
    )


@app.command()
def tune(
    estimator: Annotated[str, typer.Option(help="A filter with parameters, for example mahony; or all.")],
    data: Annotated[list[Path], typer.Option(help="Dataset to tune on; give it again to mix several.")],
    out: Annotated[Path, typer.Option(help="TOML file to write the parameters into; others in it are kept.")],
    particles: Annotated[int, typer.Option(min=2, help="Parameter sets tried at once.")] = 100,
    iterations: Annotated[int, typer.Option(min=1, help="How often.")] = 50,
    flights: Annotated[
        int | None, typer.Option(min=1, help="Flights of each dataset to use; all when left out.")
    ] = None,
    initial: Annotated[
        Initial, typer.Option(help="Whether the filter is told the attitude it starts at.")
    ] = "unknown",
    search: Annotated[
        Search, typer.Option(help="swarm (the paper's), or evolution (scipy's) to check it.")
    ] = "swarm",
    threads: Annotated[int, typer.Option(min=1, help="Threads.")] = 2,
    seed: Seed = 0,
) -> None:
    """Tune a filter on recorded flights with the paper's particle swarm.

    The command is written beside the parameters. With all, filterpy's two filters take the parameters of ekf,
    whose model they have.

    Example: quadsim tune --estimator mahony --data data/train.zarr --out mine.toml
    """
    from estimators.tuning import tunable, write_tuning
    from estimators.tuning import tune as tune_filter

    from .dataset import open_dataset

    flown = [open_dataset(path) for path in data]
    options = [f"--data {path}" for path in data]
    options += [f"--particles {particles} --iterations {iterations}"]
    options += [f"--flights {flights}"] * (flights is not None)
    options += [f"--initial {initial} --search {search} --seed {seed} --out {out}"]
    for name in tunable() if estimator == "all" else [estimator]:
        with progress_bar(f"tune {name}", "iterations") as bar:

            def progress(iteration: int, total: int, cost: float, bar: Bar = bar) -> None:
                bar(iteration, total, f"best {math.degrees(math.sqrt(cost)):.3f}° RMSE ({cost:.3g} rad²)")

            tuned = tune_filter(
                name,
                flown,
                particles=particles,
                iterations=iterations,
                seed=seed,
                initial=initial,
                flights=flights,
                search=search,
                workers=threads,
                command=f"quadsim tune --estimator {name} {' '.join(options)}",
                progress=progress,
            )
        write_tuning(out, name, tuned, f"Tuned on {', '.join(map(str, data))} (quadsim tune)")
        values = ", ".join(f"{key} {value:.4g}" for key, value in tuned.values.items())
        console.print(f"{out}: {name} {tuned.rmse_deg:.3f}° RMSE with {values}", soft_wrap=True)


@app.command()
def evaluate(
    data: Annotated[
        Path | None, typer.Option(help="Dataset of flights that were not tuned or trained on.")
    ] = None,
    logs: Annotated[
        list[Path] | None, typer.Option(help="Real log in place of --data; give it again for more.")
    ] = None,
    estimator: Annotated[
        list[str] | None, typer.Option(help="Estimator; give it again for more. All if left out.")
    ] = None,
    weights: Annotated[
        list[str] | None, typer.Option(help="With --logs: weights file of an att-snn to score too.")
    ] = None,
    within: Annotated[
        float, typer.Option(min=1, max=180, help="With --logs: largest true inclination scored, in °.")
    ] = 45.0,
    axes: Annotated[
        str | None, typer.Option(help='With --logs: body x, y, z as its axes ("z,-y,x").')
    ] = None,
    tuning: Annotated[
        str | None, typer.Option(help="Tuned parameters: a shipped domain or a TOML file.")
    ] = None,
    slow_flights: Annotated[
        int, typer.Option(min=1, help="Flights for filterpy's filters, hundreds of times as slow as others.")
    ] = 4,
    out: Annotated[Path, typer.Option(help="Folder for the table, its figures and the report.")] = Path(
        "reports/evaluate"
    ),
    seed: Seed = 0,
) -> None:
    """Compare estimators on recorded flights: errors, convergence, run time, with confidence intervals.

    Each is also compared with the best one flight by flight; those that the flights cannot tell from it are
    tied. Writes evaluation.csv, the violins, the error over time and the convergence as PNG, and report.html;
    of real logs logs.csv and a picture each, with a row "level" that shows how hard the log is.

    Example: quadsim evaluate --data data/test.zarr --estimator mahony --estimator att-snn-loihi
    """
    if (data is None) == (not logs):
        raise ValueError("one of --data and --logs is wanted")
    if logs:
        from scenarios.recorded import evaluate_logs

        evaluate_logs(logs, estimator, weights or [], within, axes, tuning, out)
        return
    assert data is not None
    import estimators
    from estimators import figures
    from estimators.evaluate import evaluate as evaluate_estimators
    from scenarios.report import write_report
    from scenarios.summary import EVALUATION_METHOD, evaluation_columns, evaluation_notes, evaluation_table

    from .dataset import open_dataset

    flown = open_dataset(data)
    with progress_bar("evaluate", "runs") as bar:
        done = evaluate_estimators(
            flown,
            estimator or estimators.names(),
            tuning=tuning,
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
        draw(done).savefig(pictures[name], dpi=130)
    caption = f"{flown.sizes['flight']} flights of {data}, without a loop."
    notes = evaluation_notes(done.rows)
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
        + (f", not told apart from {', '.join(tied)}" if tied else ""),
        soft_wrap=True,
    )


@app.command()
def fly(
    scenario: Annotated[
        str, typer.Argument(help="A shipped scenario, for example wind-gust, or a TOML file.")
    ],
    estimator: Annotated[str, typer.Option(help="Estimator to fly on.")] = "att-snn-loihi",
    out: Annotated[
        Path | None, typer.Option(help="Folder; reports/fly-SCENARIO-ESTIMATOR when left out.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.1, help="Length in seconds, not the scenario's.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Number of flights.")] = 1,
    rate: Rate = 200.0,
    seed: Seed = 0,
    flight: Annotated[
        int, typer.Option(min=0, help="Number of the first flight, as in the flights.csv of quadsim bench.")
    ] = 0,
    video: Annotated[bool, typer.Option("--video", help="Make an MP4 of the first flight.")] = False,
    view: Annotated[bool, typer.Option("--view", help="Show the first flight in MuJoCo's viewer.")] = False,
) -> None:
    """Fly one scenario on one estimator and look at it closely: report, every sample as CSV, video.

    Example: quadsim fly wind-gust --estimator att-snn-loihi --video
    """
    from scenarios.single import fly_scenario

    folder = out or Path("reports") / f"fly-{Path(scenario).stem}-{estimator}"
    try:
        flown = fly_scenario(
            scenario,
            estimator,
            folder,
            seeds=seeds,
            seed=seed,
            flight=flight,
            duration_s=duration,
            rate_hz=rate,
            video=video,
            view=view,
        )
    except RuntimeError as error:  # no OpenGL for the video, no screen for the view
        raise ValueError(str(error)) from error
    row = flown.results.rows[0]
    if row["reason"]:
        raise ValueError(f"{estimator} did not fly {scenario}: {row['reason']}")
    error = "no error to speak of" if row["error_deg"] is None else f"error {row['error_deg']:.2f}°"
    console.print(f"{flown.report}: {row['crashes']} of {row['flights']} crashed, {error}", soft_wrap=True)


@app.command()
def bench(
    out: Annotated[Path, typer.Option(help="Folder for report.html, results.csv and flights.csv.")] = Path(
        "reports/bench"
    ),
    scenario: Annotated[
        list[str] | None, typer.Option(help="Scenario; give it again for more. All if left out.")
    ] = None,
    estimator: Annotated[list[str] | None, typer.Option(help="Estimator; likewise.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Flights in each cell.")] = 10,
    duration: Annotated[
        float | None, typer.Option(min=0.1, help="Length in seconds, not the scenarios'.")
    ] = None,
    external: Annotated[
        str | None,
        typer.Option(help="External sensor instead of the scenarios': ideal, motion-capture or a TOML file."),
    ] = None,
    breaking_point: Annotated[
        list[str] | None,
        typer.Option(
            help="Find also where each estimator breaks: wind, bias, dropout; again for more, or all."
        ),
    ] = None,
    rate: Rate = 200.0,
    seed: Seed = 0,
    workers: Workers = None,
    cluster: Annotated[str | None, typer.Option(help="Address of a Dask scheduler to run on.")] = None,
) -> None:
    """Fly scenarios × estimators × seeds in closed loop, and report which estimator to fly.

    Finished cells are kept: the same command goes on where a killed run stopped. Breaking points are found by
    bisection, on the same estimators and seeds, and join the report.

    Example: quadsim bench --scenario hover --scenario wind-gust --estimator att-snn-loihi --estimator mahony
    """
    import estimators
    from scenarios.breaking import breaking_points, chosen
    from scenarios.publish import publish
    from scenarios.runner import bench as run_bench
    from scenarios.runner import code_digest
    from scenarios.summary import breaking_table, closed_loop_table

    from .scenario import scenario_names

    names = estimator or estimators.names()
    searched = chosen(breaking_point or [])
    with executor_of(cluster) as executor:
        with progress_bar("fly", "cells") as progress:
            results = run_bench(
                scenario or scenario_names(),
                names,
                seeds,
                out,
                seed=seed,
                duration_s=duration,
                external=external,
                rate_hz=rate,
                workers=workers,
                executor=executor,
                progress=progress,
            )
        points = []
        if searched:
            with progress_bar("break", "points") as progress:
                points = breaking_points(
                    searched,
                    names,
                    seeds,
                    out,
                    code=code_digest(),
                    seed=seed,
                    duration_s=duration,
                    external=external,
                    rate_hz=rate,
                    workers=workers,
                    executor=executor,
                    progress=progress,
                )
    page, note = publish(out, results, points)
    console.print(closed_loop_table(results))
    if points:
        console.print(breaking_table(points))
    if note:
        console.print(note, soft_wrap=True)
    console.print(headline(page, results.rows), soft_wrap=True)


@app.command()
def inspect(
    weights: Annotated[
        Path | None, typer.Option(help="Weights of an Att-SNN; the ones that ship when left out.")
    ] = None,
    data: Annotated[
        list[Path] | None, typer.Option(help="Dataset to watch the neurons on; give it again for more.")
    ] = None,
    profiles: Annotated[
        int | None,
        typer.Option(min=3, help="Share this many decay profiles among all neurons; written to --out."),
    ] = None,
    prune: Annotated[
        float | None, typer.Option(min=0.01, max=0.95, help="Remove this share of the neurons, training on.")
    ] = None,
    train_data: Annotated[
        list[Path] | None, typer.Option("--train", help="With --prune: dataset to train on; --data chooses.")
    ] = None,
    criterion: Annotated[
        str, typer.Option(help="With --prune: activity, magnitude, contribution or random.")
    ] = "activity",
    stages: Annotated[int, typer.Option(min=1, help="With --prune: steps to get there.")] = 3,
    epochs: Annotated[int, typer.Option(min=1, help="With --prune: epochs of training after each.")] = 10,
    out: Annotated[Path, typer.Option(help="Folder for figures, page and pruned weights.")] = Path(
        "reports/inspect"
    ),
    seed: Seed = 0,
) -> None:
    """Look inside a spiking network: its place on the chip, its spikes, what they encode and cost.

    Without --data: the chip's cores alone. With it: rates, raster, membranes, ablation, manipulated inputs,
    tuning curves and energy, as pictures and a page. With --prune also a smaller network, trained on.

    Example: quadsim inspect --data data/val.zarr
    """
    from estimators.flights import load_flights
    from estimators.inspection import inspect as look_inside
    from estimators.inspection import load_spiking, write_page
    from estimators.networks import OnLoihi
    from estimators.weights_file import save_network
    from scenarios.summary import cores_table, plain_table, stages_table

    from .dataset import open_dataset

    name, config, tensors = load_spiking(weights, profiles)
    core = OnLoihi(config, tensors)
    console.print(cores_table(core.cores))
    last = f"{name}: {sum(core.chip.sizes)} neurons on {len(core.cores)} of a chip's 128 cores"
    if profiles is not None:
        weights = out / f"profiles-{profiles}.safetensors"
        out.mkdir(parents=True, exist_ok=True)
        save_network(weights, config, tensors)
    if data:
        flights = load_flights([open_dataset(path) for path in data])
        with progress_bar("inspect", "parts") as bar:
            found = look_inside(name, config, tensors, flights, bar)
        console.print(plain_table(found.summary()))
        last = f"{write_page(out, found)}: {last}, error {found.responses['intact'].error_deg:.2f}°"
    if prune is not None:
        from training.pruning import prune as prune_network

        if not data or not train_data:
            raise ValueError("--prune needs --train, datasets to train on, and --data, datasets to choose by")
        with progress_bar("prune", "epochs") as bar:
            done = prune_network(
                tuple(map(str, train_data)),
                tuple(map(str, data)),
                out / "prune",
                prune,
                stages,
                criterion,
                weights,
                lambda epoch, run: bar(epoch.epoch + 1, run.epochs, f"{epoch.val_error_deg:.2f}°"),
                epochs=epochs,
                seed=seed,
            )
        console.print(stages_table(done))
        last = f"{done[-1].weights}: {100 * done[-1].removed:.0f} % removed, {done[-1].tuned_deg:.2f}°"
    console.print(last, soft_wrap=True)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="Folder that quadsim bench wrote.")],
    out: Annotated[Path | None, typer.Option(help="HTML file; FOLDER/report.html when left out.")] = None,
) -> None:
    """Write the report of finished closed-loop flights again."""
    from scenarios.breaking import load_points
    from scenarios.publish import publish
    from scenarios.runner import load_results

    results = load_results(folder)
    points = [each for each in load_points(folder) if each.estimator in results.settings.estimators]
    console.print(headline(publish(folder, results, points, out).report, results.rows), soft_wrap=True)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything.")] = Path("reports/demo"),
    flights: Annotated[int, typer.Option(min=1, help="Flights to generate.")] = 6,
    seeds: Annotated[int, typer.Option(min=1, help="Flights of each estimator in each scenario.")] = 5,
    seed: Seed = 0,
    workers: Workers = None,
) -> None:
    """Do all of it in small: generate flights, score the estimators on them, fly them, write the report."""
    from scenarios.demo import demo as run_demo
    from scenarios.summary import closed_loop_table, offline_table

    done = run_demo(out, flights=flights, seeds=seeds, seed=seed, workers=workers, stage=progress_bar)
    console.print(offline_table(done.offline))
    console.print(closed_loop_table(done.results))
    if done.note:
        console.print(done.note, soft_wrap=True)
    console.print(headline(done.report, done.results.rows), soft_wrap=True)


@app.command()
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
    from scenarios.summary import plain_table

    with progress_bar("paper", "s of work") as bar:
        done = make_paper(out, only, preset, seed, workers, bar)
    rows = [(each.claim, each.verdict) for each in done.judged if each.verdict != "not judged"]
    if rows:
        console.print(plain_table(rows))
    console.print(f"{done.page}: {done.headline}", soft_wrap=True)


def headline(path: Path, rows: Sequence[dict[str, Any]]) -> str:
    """Where the report is, and what its verdict says."""
    from scenarios.verdict import verdict

    return f"{path}: {verdict(rows).headline}"


def time_left(seconds: float, done: int, total: int) -> str:
    """How long the rest takes at the pace so far, at most: "12 min"."""
    left = seconds / done * (total - done)
    if left < 100:
        return f"{left:.0f} s"
    return f"{left / 60:.0f} min" if left < 6000 else f"{left / 3600:.1f} h"


def pair_of(text: str) -> tuple[str, object]:
    """A setting given as name=value; the value is read as TOML, or as it stands."""
    name, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"--set takes name=value, not {text!r}")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return name, value


def main() -> None:
    """Run the command line: a user's mistake is one line and exit code 2."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    try:
        app(prog_name="quadsim")
    except (ValueError, OSError) as error:
        message = str(error) or type(error).__name__
        Console(stderr=True).print(
            f"quadsim: {' '.join(message.split())}", style="red", markup=False, soft_wrap=True
        )
        sys.exit(2)
    except KeyboardInterrupt:
        Console(stderr=True).print("quadsim: interrupted; the same command goes on where this one stopped")
        sys.exit(130)


if __name__ == "__main__":
    main()
