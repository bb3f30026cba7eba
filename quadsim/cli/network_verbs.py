"""Commands that make weights and parameters: `train`, `tune`."""

import math
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..runs.console import Bar, progress_bar, say
from ..runs.pool import process_count
from ..runs.record import command_line
from .options import LearningSeed, fields_of

if TYPE_CHECKING:
    from training.epochs import Config
    from training.run_folder import Epoch

TRAINED = ("model", "preset", "data", "validation", "seed", "out", "progress")
"""Settings of a training that have an option of their own, or follow from others."""


def train(
    out: Annotated[Path, typer.Option(help="Folder for the run, for example runs/snn.")],
    data: Annotated[
        list[Path] | None,
        typer.Option(
            help="Dataset to train on; repeat the option to mix several. Controllers need no dataset; "
            "att-snn generates its own flights if none is given."
        ),
    ] = None,
    model: Annotated[
        str, typer.Option(help="For networks of layers: att-snn (spiking) or att-rnn (in floats).")
    ] = "att-snn",
    preset: Annotated[
        str,
        typer.Option(
            help="att-snn: a circuit like the shipped one, for any IMU. tune: trains the shipped circuit on "
            "your logs. paper: the paper's network of layers. control-attitude: a controller. Or a TOML file."
        ),
    ] = "att-snn",
    validation: Annotated[
        list[Path] | None,
        typer.Option(
            help="Dataset that selects the best epoch; default: a part of --data. A circuit keeps its last "
            "weights; the dataset only shows its error."
        ),
    ] = None,
    epochs: Annotated[
        int | None, typer.Option(min=1, help="Maximum number of epochs; default: the preset's.")
    ] = None,
    tensorboard: Annotated[
        bool,
        typer.Option(
            "--tensorboard", help="Also write the losses of each epoch to the folder, for TensorBoard."
        ),
    ] = False,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Any other setting, as name=value or table.name=value. For an unknown name, the list is "
            "printed.",
        ),
    ] = None,
    seed: LearningSeed = 0,
) -> None:
    """Train a spiking network for the chip, or its counterpart in floats.

    The preset att-snn trains a spiking circuit like the shipped one, for any IMU, starting from the
    equation of gravity in a rotating frame. tune continues training the shipped circuit on your own logs.
    paper trains a network of layers by the paper's recipe. control-attitude trains an attitude controller
    by imitation, on flights that it generates.

    The run folder contains the weights, the losses (log.csv) and their plot. Ctrl-C stops the run and keeps
    its results, and the same command continues it.

    Example: quadsim train --out runs/snn

    Example: quadsim train --preset tune --data data/mine.zarr --out runs/mine

    """
    choices = fields_of(set_, *TRAINED)
    if epochs is not None:
        choices["epochs"] = epochs
    if validation:
        choices["validation"] = tuple(map(str, validation))
    from training.config import make_config
    from training.epochs import INTERRUPTED, run
    from training.run_folder import tensorboard_events

    config = make_config(preset, model=model, data=tuple(map(str, data or [])), seed=seed, **choices)
    events = tensorboard_events(out) if tensorboard else nullcontext()
    with events as write, progress_bar(f"train {preset}", "epochs") as bar:

        def progress(epoch: "Epoch", config: "Config") -> None:
            if write:
                write(epoch)
            bar(epoch.epoch + 1, config.epochs)
            say(f"epoch {epoch.epoch + 1}: {epoch}")

        result = run(
            config,
            out,
            progress,
            lambda done, total: bar(0, config.epochs, f"{done} of {total} flights generated"),
        )
    best = result.best
    say(f"{result.weights}: {best} at epoch {best.epoch + 1}; {result.reason}")
    if result.reason == INTERRUPTED:
        raise KeyboardInterrupt


def tune(
    estimator: Annotated[
        str,
        typer.Option(
            help="A filter with parameters, for example mahony; your own file.py:Class with declared "
            "parameters; or all."
        ),
    ],
    data: Annotated[list[Path], typer.Option(help="Dataset to tune on; repeat the option to mix several.")],
    out: Annotated[
        Path, typer.Option(help="TOML file for the parameters; other filters in the file are kept.")
    ],
    particles: Annotated[int, typer.Option(min=2, help="Number of parameter sets in the swarm.")] = 100,
    iterations: Annotated[int, typer.Option(min=1, help="Number of iterations.")] = 50,
    flights: Annotated[
        int | None, typer.Option(min=1, help="Number of flights of each dataset; default: all.")
    ] = None,
    pieces: Annotated[
        int, typer.Option(min=1, help="Number of parts of each flight; all but the first begin in motion.")
    ] = 1,
    search: Annotated[
        Literal["swarm", "evolution"],
        typer.Option(help="swarm: the paper's particle swarm. evolution: SciPy's differential evolution."),
    ] = "swarm",
    seed: LearningSeed = 0,
) -> None:
    """Tune a filter on recorded flights with the paper's particle swarm.

    The TOML file also records the command. With --estimator all, filterpy's two filters get the parameters of
    ekf, because they have the same model.

    Example: quadsim tune --estimator mahony --data data/train.zarr --out mine.toml
    """
    from estimators.tuned import load_tuning
    from estimators.tuning.search import SearchSettings, tunable, write_tuning
    from estimators.tuning.search import tune as tune_filter

    from ..dataset.reading import open_dataset

    if out.exists():
        load_tuning(out)  # a file that cannot be kept is refused before the search
    datasets = [open_dataset(path) for path in data]
    for name in tunable() if estimator == "all" else [estimator]:
        with progress_bar(f"tune {name}", "iterations") as bar:

            def progress(iteration: int, total: int, cost: float, bar: Bar = bar) -> None:
                bar(iteration, total, f"best {math.degrees(math.sqrt(cost)):.3f}° RMSE ({cost:.3g} rad²)")

            tuned = tune_filter(
                name,
                datasets,
                SearchSettings(search, particles, iterations, seed),
                flights=flights,
                pieces=pieces,
                workers=process_count(None, particles),
                command=command_line(),
                progress=progress,
            )
        write_tuning(out, name, tuned, f"Tuned on {', '.join(map(str, data))} (quadsim tune)")
        values = ", ".join(f"{key} {value:.4g}" for key, value in tuned.values.items())
        say(f"{out}: {name} {tuned.rmse_deg:.3f}° RMSE with {values}")
