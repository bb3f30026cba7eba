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
"""Settings of a training that `--set` cannot change: an option sets them, or they follow from others."""


def train(
    out: Annotated[Path, typer.Option(help="Folder for the results of the training, for example runs/snn.")],
    data: Annotated[
        list[Path] | None,
        typer.Option(
            help="Dataset to train on. Repeat the option to mix several datasets. The preset att-snn "
            "generates flights if no dataset is given. Controllers need no dataset."
        ),
    ] = None,
    model: Annotated[
        str, typer.Option(help="For the preset paper: att-snn (spiking) or att-rnn (GRU, in floats).")
    ] = "att-snn",
    preset: Annotated[
        str,
        typer.Option(
            help="att-snn: train the shipped spiking circuit again. tune: continue training the shipped "
            "circuit on your logs. paper: train the paper's network of layers. control-attitude: train a "
            "controller. You can also give your own TOML file."
        ),
    ] = "att-snn",
    validation: Annotated[
        list[Path] | None,
        typer.Option(
            help="Dataset that selects the best epoch. Default: a part of --data. For the presets att-snn "
            "and tune, the dataset selects nothing: the training prints the error on it and keeps the last "
            "weights."
        ),
    ] = None,
    epochs: Annotated[
        int | None, typer.Option(min=1, help="Maximum number of epochs. Default: the preset's.")
    ] = None,
    tensorboard: Annotated[
        bool,
        typer.Option(
            "--tensorboard", help="Also write the losses of each epoch for TensorBoard, to the folder --out."
        ),
    ] = False,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Any other setting of the preset, as name=value or table.name=value. An unknown name prints "
            "the valid names. Repeat the option to set more.",
        ),
    ] = None,
    seed: LearningSeed = 0,
) -> None:
    """Train a spiking network for the chip, or its counterpart in floats.

    The preset att-snn trains a spiking circuit with the architecture of the shipped one. The initial weights
    follow from the equation of motion of gravity in a rotating frame. The preset tune continues training the
    shipped circuit on your own logs. The preset paper trains the paper's network of layers. The preset
    control-attitude trains an attitude controller to imitate a teacher in simulated flights.

    The output folder contains the weights, the losses (log.csv) and a plot of the losses. Ctrl-C stops the
    training and keeps the results so far. The same command continues the training.

    Example: quadsim train --out runs/snn

    Example: quadsim train --preset tune --data data/mine.zarr --out runs/mine
    """
    choices = fields_of(set_, *TRAINED)
    if epochs is not None:
        choices["epochs"] = epochs
    if validation:
        choices["validation"] = tuple(map(str, validation))
    from training.config import make_config
    from training.epochs import INTERRUPTED, train_epochs
    from training.run_folder import tensorboard_events

    config = make_config(preset, model=model, data=tuple(map(str, data or [])), seed=seed, **choices)
    events = tensorboard_events(out) if tensorboard else nullcontext()
    with events as write, progress_bar(f"train {preset}", "epochs") as bar:

        def progress(epoch: "Epoch", config: "Config") -> None:
            if write:
                write(epoch)
            bar(epoch.epoch + 1, config.epochs)
            say(f"epoch {epoch.epoch + 1}: {epoch}")

        result = train_epochs(
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
            help="A filter, for example mahony; your own file.py:Class that declares parameters; or all, "
            "which tunes every filter."
        ),
    ],
    data: Annotated[
        list[Path], typer.Option(help="Dataset to tune on. Repeat the option to mix several datasets.")
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="TOML file for the parameters. If the file exists, the tables of other filters are kept."
        ),
    ],
    particles: Annotated[int, typer.Option(min=2, help="Number of parameter sets in the swarm.")] = 100,
    iterations: Annotated[int, typer.Option(min=1, help="Number of iterations.")] = 50,
    flights: Annotated[
        int | None, typer.Option(min=1, help="Number of flights to use from each dataset. Default: all.")
    ] = None,
    pieces: Annotated[
        int,
        typer.Option(
            min=1, help="Number of parts to cut each flight into. All parts but the first begin in motion."
        ),
    ] = 1,
    search: Annotated[
        Literal["swarm", "evolution"],
        typer.Option(
            help="swarm: particle swarm, as in the reproduced paper. evolution: SciPy's differential "
            "evolution."
        ),
    ] = "swarm",
    seed: LearningSeed = 0,
) -> None:
    """Tune the parameters of a filter on recorded flights.

    The TOML file also records the command. With --estimator all, ekf-filterpy and ukf-filterpy are not tuned:
    they get the parameters of ekf, because they have the same model.

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
