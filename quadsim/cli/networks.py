"""Verbs that make weights and parameters: `train`, `tune`."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runs.console import Bar, pool_of, progress_bar
from ..runs.console import output as console
from ..runs.pool import process_count
from .options import (
    Fields,
    Initial,
    LearningSeed,
    Pool,
    Preset,
    Search,
    fields_of,
    time_left,
)

if TYPE_CHECKING:
    from training.config import TrainConfig

TRAINED = ("model", "preset", "data", "validation", "folds", "fold", "seed", "out", "progress")
"""Fields of a training that have options of their own, or follow from others."""


def train(
    out: Annotated[Path, typer.Option(help="Folder of the run, for example runs/snn.")],
    data: Annotated[
        list[Path] | None,
        typer.Option(
            help="Dataset to train on; again to mix several, or with --folds for another domain. "
            "A controller has none."
        ),
    ] = None,
    model: Annotated[str, typer.Option(help="att-snn or att-rnn.")] = "att-snn",
    preset: Preset = "paper",
    validation: Annotated[
        list[Path] | None,
        typer.Option(help="Dataset to choose the best epoch by; else part of --data."),
    ] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="Most epochs, instead of the preset's.")] = None,
    folds: Annotated[
        int | None,
        typer.Option(
            min=2,
            help="Cross-validate: deal the flights of each --data into so many parts, train without each "
            "in turn, and test on it and on the other datasets.",
        ),
    ] = None,
    workers: Pool = None,
    set_: Fields = None,
    seed: LearningSeed = 0,
) -> None:
    """Train Att-SNN as the chip will run it, or its non-spiking twin Att-RNN.

    Writes the best weights, a row of losses per epoch and their plot; Ctrl-C keeps the best weights, and the
    same command continues a run that stopped. The default preset is the paper's recipe; hummingbird is more
    accurate for one airframe and IMU, best for any IMU; control-attitude and control-separate train attitude
    controllers, by imitation in flights of their own.

    With --folds it writes the paper's Table 1 (table1.csv), every fold (kfold.csv), and a run folder for
    each; folds run side by side, on --workers.

    Example: quadsim train --preset best --data data/train.zarr --validation data/val.zarr --out runs/snn

    Example: quadsim train --data data/train.zarr --data data/train-px4.zarr --folds 5 --out runs/kfold
    """
    choices = fields_of(set_, *TRAINED, "workers", "executor")
    if epochs is not None:
        choices["epochs"] = epochs
    if validation:
        choices["validation"] = tuple(map(str, validation))
    if folds:
        _cross_validate(out, data or [], model, preset, folds, workers, choices | {"seed": seed})
    else:
        _train_network(out, data or [], model, preset, choices | {"seed": seed})


def _train_network(out: Path, data: list[Path], model: str, preset: str, choices: dict[str, object]) -> None:
    from training.loop import INTERRUPTED
    from training.loop import train as train_network
    from training.run_folder import Epoch

    with progress_bar(f"train {preset}", "epochs") as bar:

        def progress(epoch: Epoch, config: "TrainConfig") -> None:
            bar(epoch.epoch + 1, config.epochs)
            console.print(
                f"epoch {epoch.epoch + 1}: training loss {epoch.train_loss:.4g}, validation {epoch}, "
                f"spike rates {epoch.rate_encoding:.3f} {epoch.rate_hidden:.3f}, "
                f"{time_left(epoch.seconds, epoch.epoch + 1, config.epochs)} left",
                highlight=False,
            )

        result = train_network(model, tuple(map(str, data)), out, preset, progress, **choices)
    best = result.best
    console.print(
        f"{result.weights}: validation {best} at epoch {best.epoch + 1}; {result.reason}", soft_wrap=True
    )
    if result.before is not None:
        helped = "it helped" if result.helped else "it did not help, keep the weights you had"
        console.print(f"loss before {result.before:.4g}, after {best.score:.4g}: {helped}", soft_wrap=True)
    if result.reason == INTERRUPTED:
        raise KeyboardInterrupt


def _cross_validate(
    out: Path,
    data: list[Path],
    model: str,
    preset: str,
    folds: int,
    workers: str | None,
    choices: dict[str, Any],
) -> None:
    from training.kfold import best as best_of
    from training.kfold import kfold, table, terminal_table

    with pool_of(workers) as (count, executor), progress_bar("folds", "epochs") as progress:
        scores = kfold(data, out, [model], preset, folds, count, executor, progress, **choices)
    cells = table(scores)
    console.print(terminal_table(cells))
    for score in scores:
        if score["flaw"]:
            where = "fold {fold} of {model} on {trained_on}, tested on {tested_on}".format(**score)
            console.print(f"{where}: {score['flaw']}", soft_wrap=True, markup=False)
    best = "{model} on unseen flights of {trained_on}: {mean_deg:.2f} ± {sd_deg:.2f}° over {folds} folds"
    console.print(f"{out / 'table1.csv'}: {best.format(**best_of(cells))}", soft_wrap=True)


def tune(
    estimator: Annotated[
        str,
        typer.Option(
            help="A filter with parameters, for example mahony; your own, file.py:Class, which declares "
            "them; or all."
        ),
    ],
    data: Annotated[list[Path], typer.Option(help="Dataset to tune on; give it again to mix several.")],
    out: Annotated[Path, typer.Option(help="TOML file to write the parameters into; others in it stay.")],
    particles: Annotated[int, typer.Option(min=2, help="Parameter sets tried at once.")] = 100,
    iterations: Annotated[int, typer.Option(min=1, help="How often.")] = 50,
    flights: Annotated[
        int | None, typer.Option(min=1, help="Flights of each dataset to use; all when left out.")
    ] = None,
    pieces: Annotated[
        int, typer.Option(min=1, help="Parts to cut each flight into: all but the first begin in motion.")
    ] = 1,
    initial: Annotated[
        Initial, typer.Option(help="Whether the filter is given the attitude it starts at.")
    ] = "unknown",
    search: Annotated[
        Search, typer.Option(help="swarm (the paper's), or evolution (scipy's) to check it.")
    ] = "swarm",
    seed: LearningSeed = 0,
) -> None:
    """Tune a filter on recorded flights with the paper's particle swarm.

    The command is written beside the parameters. With all, filterpy's two filters take the parameters of ekf,
    whose model they have.

    Example: quadsim tune --estimator mahony --data data/train.zarr --out mine.toml
    """
    from estimators.tuning.search import FlightSelection, SearchSettings, tunable, write_tuning
    from estimators.tuning.search import tune as tune_filter

    from ..dataset.reading import open_dataset

    datasets = [open_dataset(path) for path in data]
    options = [f"--data {path}" for path in data]
    options += [f"--particles {particles} --iterations {iterations}"]
    options += [f"--flights {flights}"] * (flights is not None)
    options += [f"--pieces {pieces}"] * (pieces > 1)
    options += [f"--initial {initial} --search {search} --seed {seed} --out {out}"]
    for name in tunable() if estimator == "all" else [estimator]:
        with progress_bar(f"tune {name}", "iterations") as bar:

            def progress(iteration: int, total: int, cost: float, bar: Bar = bar) -> None:
                bar(iteration, total, f"best {math.degrees(math.sqrt(cost)):.3f}° RMSE ({cost:.3g} rad²)")

            tuned = tune_filter(
                name,
                datasets,
                SearchSettings(search, particles, iterations, seed),
                FlightSelection(flights, pieces, initial),
                workers=process_count(None, particles),
                command=f"quadsim tune --estimator {name} {' '.join(options)}",
                progress=progress,
            )
        write_tuning(out, name, tuned, f"Tuned on {', '.join(map(str, data))} (quadsim tune)")
        values = ", ".join(f"{key} {value:.4g}" for key, value in tuned.values.items())
        console.print(f"{out}: {name} {tuned.rmse_deg:.3f}° RMSE with {values}", soft_wrap=True)
