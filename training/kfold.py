"""K-fold cross-validation within a domain, and across domains: the paper's Table 1.

Every fold of every domain (a dataset) trains a network in a run folder of its own and is then scored on the
flights that it was trained on, on those that it was not shown, and on the whole of every other domain.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor, Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from estimators.metrics import attitude_error
from estimators.networks.network import create_network
from quadsim.runs.files import drop_parts, read_json, write_csv, write_json
from quadsim.runs.pool import WORKER_DIED, process_count, run_jobs

from .config import TrainConfig, make_config
from .cross_domain import TEST, TRAIN, Score, plot, table
from .data import Flights, load_flights
from .loop import INTERRUPTED, flights_of, run
from .run_folder import claim, contents_of

log = logging.getLogger(__name__)

Progress = Callable[[int, int, str], None]
"""progress(epochs done, at most, how many folds are done)."""


@dataclass(frozen=True)
class Job:
    """One fold to train and to score."""

    config: TrainConfig
    domain: str
    others: dict[str, str]
    """Name and path of every other domain."""
    out: Path


FOLDED = (
    "model",
    "preset",
    "data",
    "validation",
    "folds",
    "fold",
    "seed",
    "out",
    "workers",
    "executor",
    "progress",
)
"""Names that are no free choice of a cross-validation."""


def kfold(
    domains: Sequence[str | Path],
    out: str | Path,
    models: Sequence[str] = ("att-snn",),
    preset: str = "paper",
    folds: int = 5,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> list[Score]:
    """Train and score every fold of every domain and model; write `kfold.csv`, `table1.csv` and `kfold.png`.

    A run that was stopped goes on: each fold resumes from its checkpoint, and a finished one is kept.

    Args:
        domains: Datasets; with more than one, each fold is also tested on all the others.
        out: Folder of the runs and the results.
        models: "att-snn", "att-rnn".
        preset: One of `training.config.PRESETS`.
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
    drop_parts(out)
    jobs = _jobs(domains, out, models, preset, folds, choices)
    for job in jobs:  # a mistake in them is said before the first is trained
        claim(job.out, job.config)
    scores = [score for found in _run_all(jobs, workers, executor, progress) for score in found]
    scores.sort(key=lambda s: (s.model, s.trained_on, s.fold))
    write_csv(out / "kfold.csv", scores)
    write_csv(out / "table1.csv", table(scores))
    plot(out / "kfold.png", scores)
    return scores


def run_fold(job: Job, progress: Callable[[], None] | None = None) -> list[Score]:
    """Train one fold, or go on with it, and score its best weights; a finished fold is read back."""
    learned, validation, test = flights_of(job.config)
    claim(job.out, job.config, contents_of(job.config, learned, validation))
    if (done := _finished(job)) is not None:
        return done
    result = run(job.config, job.out, lambda epoch, config: progress() if progress else None)
    if result.reason == INTERRUPTED:
        raise KeyboardInterrupt
    sets = {TRAIN: learned, TEST: test} | {name: load_flights([path]) for name, path in job.others.items()}
    scores = [
        Score(
            job.config.model, job.domain, job.config.fold, name, len(flights), *errors, result.best.epoch + 1
        )
        for name, flights in sets.items()
        for errors in [_errors(job.config.model, result.weights, flights)]
    ]
    write_json(job.out / "scores.json", [asdict(score) for score in scores])
    return scores


def _jobs(
    domains: Sequence[str | Path], out: Path, models: Sequence[str], preset: str, folds: int,
    choices: dict[str, Any],
) -> list[Job]:  # fmt: skip
    paths = {Path(path).name.removesuffix(".zarr"): str(path) for path in domains}
    if not paths or len(paths) != len(domains):
        raise ValueError(f"domains: {', '.join(map(str, domains)) or 'none'}; each needs a name of its own")
    for name in ("folds", "fold", "data", "validation"):
        if name in choices:
            raise ValueError(f"{name} follows from the folds; it cannot be set")
    made = []
    for model in dict.fromkeys(models):
        for name, path in paths.items():
            others = {other: there for other, there in paths.items() if other != name}
            for fold in range(folds):
                config = make_config(preset, model=model, data=path, folds=folds, fold=fold, **choices)
                made.append(Job(config, name, others, out / f"{model}--{name}--{fold}"))
            flights_of(made[-1].config)  # says what is wrong with the dataset, if anything is
    return made


def _finished(job: Job) -> list[Score] | None:
    """The scores of a fold that is done, if they are for the same domains."""
    try:
        scores = [Score(**row) for row in read_json(job.out / "scores.json")]
    except (FileNotFoundError, ValueError, TypeError):
        return None
    return scores if [s.tested_on for s in scores] == [TRAIN, TEST, *job.others] else None


def _errors(model: str, weights: Path, flights: Flights) -> tuple[float, float]:
    """Mean over flights of the mean absolute error, and its standard deviation [deg]."""
    est = create_network(model, flights.rate_hz, weights)
    est.reset(len(flights))
    error = attitude_error(est.sequence(flights.gyro, flights.accel), flights.roll_pitch)
    return error.mean, error.sd


def _run_all(
    jobs: Sequence[Job], workers: int | None, executor: Executor | None, progress: Progress | None
) -> list[list[Score]]:
    """Run the folds wherever they are to be run: the scores of each."""

    def tick(running: Iterable[int] = ()) -> None:
        if progress:
            done = [(job.out / "scores.json").is_file() for job in jobs]
            epochs = [job.config.epochs if d else _epochs(job.out) for job, d in zip(jobs, done, strict=True)]
            most = sum(job.config.epochs for job in jobs)
            progress(sum(epochs), most, f"{sum(done)} of {len(jobs)} folds done")

    here = executor is None and process_count(workers, len(jobs)) == 1
    arguments = {k: (job, tick) if here else (job,) for k, job in enumerate(jobs)}
    try:
        return [scores for _, scores in run_jobs(run_fold, arguments, workers, executor, tick=tick)]
    except BrokenExecutor as error:
        raise ChildProcessError(WORKER_DIED) from error


def _epochs(out: Path) -> int:
    """Epochs that a run has behind it."""
    try:
        return len((out / "log.csv").read_text(encoding="utf-8").splitlines()) - 1
    except FileNotFoundError:
        return 0
