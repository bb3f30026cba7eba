"""K-fold cross-validation within a domain, and across domains: the paper's Table 1.

Every fold of every domain (a dataset) trains a network in a run folder of its own and is then scored on its
training flights, on its test flights, and on all flights of every other domain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from rich.table import Column, Table

from estimators.metrics import attitude_error, flaw_of
from estimators.networks.network import create_network
from quadsim.runs.files import alone, drop_parts, read_json, write_csv, write_json
from quadsim.runs.pool import WORKER_DIED, process_count, run_jobs

from .config import TrainConfig, make_config
from .data import flights_of, load_training_flights
from .loop import DIVERGED, INTERRUPTED, run, task_of
from .run_folder import claim, contents_of

Progress = Callable[[int, int, str], None]
"""progress(epochs done, most epochs, a text with the number of folds done)."""
Rows = list[dict[str, Any]]
"""Rows of a table, by column."""

TRAIN, TEST = "(train)", "(test)"
"""What a network was tested on, of its own domain: its training flights and its held-out ones."""


@dataclass(frozen=True)
class Job:
    """One fold to train and to score."""

    config: TrainConfig
    domain: str
    others: dict[str, str]
    """Name and path of every other domain."""
    out: Path


def kfold(
    domains: Sequence[str | Path],
    out: str | Path,
    models: Sequence[str] = ("att-snn",),
    preset: str | Path = "paper",
    folds: int = 5,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> Rows:
    """Train and score every fold of every domain and model; write `kfold.csv` and `table1.csv`.

    A run that was stopped continues: each fold resumes from its checkpoint, and a finished one is read back.
    The table has a row for each fold's network and each set of flights: the mean absolute error of roll and
    pitch over complete flights from an unknown initial attitude, the standard deviation of the flights'
    errors [deg], the best epoch, and what is wrong with the estimates (`estimators.metrics.flaw_of`).

    Args:
        domains: Datasets; with more than one, each fold is also tested on all the others.
        out: Folder of the runs and the results.
        models: "att-snn", "att-rnn".
        preset: Name of a shipped preset, or a TOML file.
        folds: Parts into which the flights of each domain are dealt.
        workers: Processes, by default one for each CPU; 1 stays in this process.
        executor: Where to run in place of processes of our own, for instance a Dask client's
            `get_executor()`; its workers need quadsim and the same file system.
        progress: Called now and then.
        choices: Fields of `TrainConfig` that differ from the preset.

    Raises:
        ValueError: A bad choice, dataset, or folder of other runs.
        FileNotFoundError: A dataset is not there.
        ChildProcessError: Worker processes keep dying.
    """
    out = Path(out)
    with alone(out):
        jobs = _jobs(domains, out, models, preset, folds, choices)
        drop_parts(out)
        for job in jobs:  # report a mistake in any of them before the first is trained
            claim(job.out, job.config)
        scores = _all_folds(jobs, workers, executor, progress)
        for name, content in (("kfold.csv", scores), ("table1.csv", table(scores))):
            write_csv(out / name, content)
    return scores


def _all_folds(
    jobs: Sequence[Job], workers: int | None, executor: Executor | None, progress: Progress | None
) -> Rows:
    def tick() -> None:
        if progress:
            done = [(job.out / "scores.json").is_file() for job in jobs]
            epochs = [job.config.epochs if d else _epochs(job.out) for job, d in zip(jobs, done, strict=True)]
            most = sum(job.config.epochs for job in jobs)
            progress(sum(epochs), most, f"{sum(done)} of {len(jobs)} folds done")

    here = executor is None and process_count(workers, len(jobs)) == 1
    arguments = {k: (job, tick) if here else (job,) for k, job in enumerate(jobs)}
    try:
        results = run_jobs(run_fold, arguments, workers, executor, tick=tick)
        scores = [score for _, of_fold in results for score in of_fold]
    except BrokenExecutor as error:
        raise ChildProcessError(WORKER_DIED) from error
    return sorted(scores, key=lambda s: (s["model"], s["trained_on"], s["fold"]))


def run_fold(job: Job, progress: Callable[[], None] | None = None) -> Rows:
    """Train one fold, or continue it, and score its best weights; a finished fold is read back."""
    if (done := _finished(job)) is not None:
        claim(job.out, job.config, contents_of(job.config, task_of(job.config, job.out).contents()))
        return done
    result = run(job.config, job.out, lambda epoch, config: progress() if progress else None)
    if result.reason == INTERRUPTED:
        raise KeyboardInterrupt
    others = {name: load_training_flights([path]) for name, path in job.others.items()}
    train, _, test = flights_of(job.config)
    scores, model = [], job.config.model
    for name, flights in {TRAIN: train, TEST: test, **others}.items():
        network = create_network(model, flights.rate_hz, weights=result.weights)
        network.reset(len(flights))
        estimate = network.sequence(flights.gyro, flights.accel)
        error, flaw = attitude_error(estimate, flights.roll_pitch), flaw_of(estimate, flights.roll_pitch)
        scores.append(
            {
                "model": model,
                "trained_on": job.domain,
                "fold": job.config.fold,
                "tested_on": name,
                "flights": len(flights),
                "error_deg": error.mean,
                "flight_sd_deg": error.sd,
                "epoch": result.best.epoch + 1,
                "flaw": result.reason if result.reason.startswith(DIVERGED) else flaw,
            }
        )
    write_json(job.out / "scores.json", scores)
    return scores


def table(scores: Rows) -> Rows:
    """The paper's Table 1: mean and standard deviation over the folds, and how many have a flaw.

    Flawed folds count, with 180° where there is no angle.
    """
    found = pd.DataFrame(scores)
    found["flawed"] = found["flaw"] != ""
    groups = found.groupby(["model", "trained_on", "tested_on"], sort=False)
    columns = {"folds": ("fold", "size"), "mean_deg": ("error_deg", "mean"), "sd_deg": ("error_deg", "std")}
    return groups.agg(**columns, flawed=("flawed", "sum")).reset_index().to_dict("records")


def best(cells: Rows) -> dict[str, Any]:
    """The entry of `table` with the smallest error on unseen flights, of those without a flawed fold.

    Raises:
        ValueError: Every model has one in every domain.
    """
    own = [cell for cell in cells if cell["tested_on"] == TEST]
    sound = [cell for cell in own if not cell["flawed"]]
    if not sound:
        folds = ", ".join("{model} on {trained_on}: {flawed} of {folds}".format(**cell) for cell in own)
        raise ValueError(f"no network can be ranked; folds with a flaw: {folds} (see kfold.csv)")
    return min(sound, key=lambda cell: cell["mean_deg"])


def terminal_table(cells: Rows) -> Table:
    """Table 1: a row for each model and domain that it was trained on, a column for each test."""
    tested = list(dict.fromkeys(cell["tested_on"] for cell in cells))
    rows = {(cell["model"], cell["trained_on"]): {} for cell in cells}
    for cell in cells:
        flawed = " ({flawed} flawed)" if cell["flawed"] else ""
        error = ("{mean_deg:.2f} ± {sd_deg:.2f}" + flawed).format(**cell)
        rows[cell["model"], cell["trained_on"]][cell["tested_on"]] = error
    own = {TRAIN: "its training flights", TEST: "its unseen flights"}
    headings = (Column(own.get(name, f"all of {name}"), justify="right") for name in tested)
    title = f"Mean absolute error of roll and pitch, mean ± SD over {cells[0]['folds']} folds, °"
    out = Table("model", "trained on", *headings, title=title)
    for (model, domain), errors in rows.items():
        out.add_row(model, domain, *(errors.get(name, "") for name in tested))
    return out


def _jobs(
    domains: Sequence[str | Path],
    out: Path,
    models: Sequence[str],
    preset: str | Path,
    folds: int,
    choices: dict[str, Any],
) -> list[Job]:
    paths = {Path(path).name.removesuffix(".zarr"): str(path) for path in domains}
    if not paths or len(paths) != len(domains):
        raise ValueError(f"domains: {', '.join(map(str, domains)) or 'none'}; each needs a name of its own")
    for name in ("folds", "fold", "data", "validation"):
        if name in choices:
            raise ValueError(f"{name} follows from the folds; it cannot be set")
    jobs = []
    for model in dict.fromkeys(models):
        for name, path in paths.items():
            others = {other: there for other, there in paths.items() if other != name}
            for fold in range(folds):
                config = make_config(preset, model=model, data=path, folds=folds, fold=fold, **choices)
                jobs.append(Job(config, name, others, out / f"{model}--{name}--{fold}"))
            flights_of(jobs[-1].config)  # refuses datasets that do not fit
    return jobs


def _finished(job: Job) -> Rows | None:
    """The scores of a fold that is done, if they are for the same domains."""
    try:
        scores = read_json(job.out / "scores.json")
    except (FileNotFoundError, ValueError):
        return None
    return scores if [s["tested_on"] for s in scores] == [TRAIN, TEST, *job.others] else None


def _epochs(out: Path) -> int:
    """Epochs that a run has done."""
    try:
        return len((out / "log.csv").read_text(encoding="utf-8").splitlines()) - 1
    except FileNotFoundError:
        return 0
