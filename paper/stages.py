"""Stages: parts of the work, each stored in a folder of its own, and redone only when they must be.

A stage is a function with settings and inputs. Its fingerprint covers its settings, those of all stages that
it takes from, and the version: while that stays the same, a finished stage is read back and a killed one goes
on in its folder (trainings from their checkpoints); another fingerprint begins an empty folder.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from quadsim.runs.files import write_whole
from quadsim.runs.fingerprint import code_digest, fingerprint
from quadsim.runs.pool import WORKER_DIED, process_count, run_jobs

RECORD = "stage.json"

Progress = Callable[[int, int, str], None]
"""progress(seconds of work done, in all, what is being done), as expected and not as measured."""


@dataclass(frozen=True)
class Stage:
    """A part of the work."""

    name: str
    make: Callable[..., None]
    """Called as make(folder, inputs, **settings) with the folders of the inputs by name; at module level."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Everything else that its files depend on, as JSON knows it."""
    inputs: tuple[str, ...] = ()
    """Stages whose files it reads."""
    seconds: float = 5.0
    """How long it may take; orders the work and moves the bar, no more."""
    alone: bool = False
    """Whether nothing else may run beside it (what it measures is time)."""


def with_inputs(stages: Mapping[str, Stage], wanted: Iterable[str]) -> list[Stage]:
    """Stages and everything that they need, inputs first."""
    found: dict[str, Stage] = {}

    def visit(name: str) -> None:
        if name not in found:
            for each in stages[name].inputs:
                visit(each)
            found[name] = stages[name]

    for name in wanted:
        visit(name)
    return list(found.values())


def fingerprints(stages: Sequence[Stage]) -> dict[str, str]:
    """Of every stage; inputs come before what needs them."""
    found: dict[str, str] = {}
    for stage in stages:
        found[stage.name] = fingerprint(
            stage.name,
            stage.make.__qualname__,
            dict(stage.settings),
            [found[name] for name in stage.inputs],
            code_digest(stage.make.__module__, "estimators"),
        )[:16]
    return found


def record_of(folder: Path) -> dict[str, Any]:
    """What a stage's folder says of itself; empty where there is none."""
    try:
        return json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return {}


def is_finished(folder: Path, fingerprint: str) -> bool:
    """Whether a folder holds all of a stage's files."""
    found = record_of(folder)
    return found.get("fingerprint") == fingerprint and "seconds" in found


def run_stages(
    stages: Sequence[Stage],
    out: Path,
    workers: int | None = None,
    progress: Progress = lambda done, total, note: None,
) -> list[str]:
    """Make what is missing, independent stages side by side.

    Args:
        stages: What is required, inputs before what needs them.
        out: Folder for the stages' folders.
        workers: Processes, by default one for each CPU; 1 stays in this process.
        progress: Called now and then.

    Returns:
        Names of the stages that were made; the others had been.

    Raises:
        ChildProcessError: A worker process died; finished stages stay.
    """
    prints = fingerprints(stages)
    missing = [stage for stage in stages if not is_finished(out / stage.name, prints[stage.name])]
    workers = process_count(workers, len(missing))
    bar = _Bar(stages, missing, out, progress)
    jobs = {
        stage.name: (stage, out / stage.name, {name: out / name for name in stage.inputs}, prints[stage.name])
        for stage in missing
    }

    def startable(waiting: Iterable[str], running: Iterable[str]) -> list[str]:
        ready = [jobs[name][0] for name in waiting if set(jobs[name][0].inputs) <= bar.done]
        return _startable(ready, workers - len(list(running)), workers)

    bar(())
    try:
        for name, _ in run_jobs(make, jobs, workers, startable=startable, tick=bar):
            bar.done.add(name)
    except BrokenExecutor as error:
        raise ChildProcessError(WORKER_DIED) from error
    return list(jobs)


def make(stage: Stage, folder: Path, inputs: Mapping[str, Path], fingerprint: str) -> None:
    """Make one stage; its folder is emptied if it holds another one."""
    if record_of(folder).get("fingerprint") != fingerprint:
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder, {"fingerprint": fingerprint})
    began = time.monotonic()
    stage.make(folder, inputs, **stage.settings)
    _write(folder, {"fingerprint": fingerprint, "seconds": round(time.monotonic() - began, 1)})


class _Bar:
    """Work done so far, in expected seconds."""

    def __init__(
        self, stages: Sequence[Stage], missing: Sequence[Stage], out: Path, progress: Progress
    ) -> None:
        self.stages, self.out, self.progress = stages, out, progress
        self.done = {stage.name for stage in stages} - {stage.name for stage in missing}

    def __call__(self, running: Iterable[str]) -> None:
        work = {stage.name: stage.seconds for stage in self.stages}
        epochs = {stage.name: stage.settings.get("epochs") for stage in self.stages}
        done = sum(work[name] for name in self.done)
        done += sum(work[name] * _share(self.out / name, epochs[name]) for name in running)
        self.progress(round(done), round(sum(work.values())), ", ".join(running))


def _share(folder: Path, epochs: int | None) -> float:
    """How much of a training is done."""
    if not epochs:
        return 0.0
    try:
        return min(1.0, (len((folder / "log.csv").read_text(encoding="utf-8").splitlines()) - 1) / epochs)
    except FileNotFoundError:
        return 0.0


def _startable(ready: Sequence[Stage], free: int, workers: int) -> list[str]:
    """What may start now: the longest first; what must be alone only when nothing else is left."""
    shared = sorted((stage for stage in ready if not stage.alone), key=lambda stage: -stage.seconds)
    if shared or free < workers:
        return [stage.name for stage in shared[: max(free, 0)]]
    return [stage.name for stage in ready[:1]]


def _write(folder: Path, record: Mapping[str, Any]) -> None:
    write_whole(folder / RECORD, json.dumps(record))
