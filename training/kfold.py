"""K-fold cross-validation within a domain, and across domains: the paper's Table 1.

Every fold of every domain (a dataset) trains a network in a run folder of its own and is then scored on its
training flights, on its test flights, and on all flights of every other domain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor, Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from estimators.metrics import attitude_error, flaw_of
from estimators.networks.network import create_network
from quadsim.runs.files import alone, drop_parts, read_json, write_csv, write_json
from quadsim.runs.pool import WORKER_DIED, process_count, run_jobs

from .config import TrainConfig, make_config
from .cross_domain import TEST, TRAIN, Score, plot, table
from .data import flights_of, load_training_flights
from .loop import DIVERGED, INTERRUPTED, run
from .run_folder import claim, contents_of

Progress = Callable[[int, int, str], None]
"""progress(epochs done, most epochs, a text with the number of folds done)."""


@dataclass(frozen=True)
class Job:
    """One fold to train and to score."""

    config: TrainConfig
    domain: str
    others: dict[str, str]
    """Name and path of every other domain."""
    out: Path


FOLDED = ("model", "preset", "data", "validation", "folds", "fold", "seed")
"""Fields that a cross-validation sets itself, or has an argument for."""


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
) -> list[Score]:
    """Train and score every fold of every domain and model; write `kfold.csv`, `table1.csv` and `kfold.png`.

    A run that was stopped continues: each fold resumes from its checkpoint, and a finished one is read back.

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
    jobs = _jobs(domains, out, models, preset, folds, choices)
    with alone(out):
        return _train_and_score(jobs, out, workers, executor, progress)


def _train_and_score(
    jobs: Sequence[Job],
    out: Path,
    workers: int | None,
    executor: Executor | None,
    progress: Progress | None,
) -> list[Score]:
    drop_parts(out)
    for job in jobs:  # report a mistake in any of them before the first is trained
        claim(job.out, job.config)

    def tick(running: Iterable[int] = ()) -> None:
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
    scores.sort(key=lambda s: (s.model, s.trained_on, s.fold))
    write_csv(out / "kfold.csv", scores)
    write_csv(out / "table1.csv", table(scores))
    plot(out / "kfold.png", scores)
    return scores


def run_fold(job: Job, progress: Callable[[], None] | None = None) -> list[Score]:
    """Train one fold, or continue it, and score its best weights; a finished fold is read back."""
    train, validation, test = flights_of(job.config)
    claim(job.out, job.config, contents_of(job.config, train, validation))
    if (done := _finished(job)) is not None:
        return done
    result = run(job.config, job.out, lambda epoch, config: progress() if progress else None)
    if result.reason == INTERRUPTED:
        raise KeyboardInterrupt
    others = {name: load_training_flights([path]) for name, path in job.others.items()}
    scores, model = [], job.config.model
    for name, flights in {TRAIN: train, TEST: test, **others}.items():
        network = create_network(model, flights.rate_hz, result.weights)
        network.reset(len(flights))
        estimate = network.sequence(flights.gyro, flights.accel)
        error, flaw = attitude_error(estimate, flights.roll_pitch), flaw_of(estimate, flights.roll_pitch)
        if result.reason.startswith(DIVERGED):
            flaw = result.reason
        size, epoch = len(flights), result.best.epoch + 1
        scores.append(
            Score(model, job.domain, job.config.fold, name, size, error.mean, error.sd, epoch, flaw)
        )
    write_json(job.out / "scores.json", [asdict(score) for score in scores])
    return scores


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


def _finished(job: Job) -> list[Score] | None:
    """The scores of a fold that is done, if they are for the same domains."""
    try:
        scores = [Score(**row) for row in read_json(job.out / "scores.json")]
    except (FileNotFoundError, ValueError, TypeError):
        return None
    return scores if [s.tested_on for s in scores] == [TRAIN, TEST, *job.others] else None


def _epochs(out: Path) -> int:
    """Epochs that a run has done."""
    try:
        return len((out / "log.csv").read_text(encoding="utf-8").splitlines()) - 1
    except FileNotFoundError:
        return 0
