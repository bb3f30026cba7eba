"""Stages: parts of the work, each stored in a folder of its own.

A stage is a function with settings and inputs. Its fingerprint covers its code, its settings and its inputs:
while that stays the same, a finished stage is read back and a killed one continues in its folder (trainings
from their checkpoints); another fingerprint begins an empty folder.
"""

import json
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from quadsim.runs.files import write_whole
from quadsim.runs.fingerprint import code_digest, fingerprint
from quadsim.runs.pool import run_jobs

RECORD, NUMBERS = "stage.json", "numbers.json"
FLIGHTS, WEIGHTS, TUNING = "flights.zarr", "best.safetensors", "tuned.toml"

Inputs = Mapping[str, Path]
"""Stage to its folder."""
Numbers = dict[str, Any]
"""What a stage measured, as JSON knows it."""
Progress = Callable[[int, int, str], None]
"""progress(stages done, all stages, the last of them)."""


@dataclass(frozen=True)
class Stage:
    """A part of the work."""

    name: str
    make: Callable[..., Numbers | None]
    """Called as make(folder, inputs, **settings); at module level. What it returns is stored in `NUMBERS`."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Everything else that its files depend on, as JSON knows it."""
    inputs: tuple[str, ...] = ()
    """Stages whose files it reads."""
    alone: bool = False
    """Whether nothing else may run beside it (what it measures is time)."""
    packages: tuple[str, ...] = ()
    """Packages that its code takes modules from by name: all of them count."""


def with_inputs(stages: Mapping[str, Stage], wanted: Iterable[str]) -> list[Stage]:
    """Stages and all that they need, in the order of `stages`, where inputs come first."""
    needed = set(wanted)
    for name in reversed(list(stages)):
        if name in needed:
            needed.update(stages[name].inputs)
    return [stage for name, stage in stages.items() if name in needed]


def fingerprints(stages: Iterable[Stage]) -> dict[str, str]:
    """Of every stage; inputs come before what needs them."""
    prints: dict[str, str] = {}
    for stage in stages:
        code = stage.make.__qualname__, code_digest(stage.make.__module__, *stage.packages)
        inputs = [prints[name] for name in stage.inputs]
        prints[stage.name] = fingerprint(stage.name, *code, dict(stage.settings), inputs)[:16]
    return prints


def record_of(folder: Path, fingerprint: str) -> dict[str, Any]:
    """The record of a stage that was begun in a folder, with "seconds" if it is finished; else empty."""
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return {}
    return record if record.get("fingerprint") == fingerprint else {}


def is_finished(folder: Path, fingerprint: str) -> bool:
    """Whether a stage was finished in a folder and all that it left there is still there."""
    record = record_of(folder, fingerprint)
    return "seconds" in record and all((folder / name).exists() for name in record["files"])


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
        progress: Called after each stage.

    Returns:
        Names of the stages that were made; the others had been.

    Raises:
        ChildProcessError: A worker process died; finished stages stay.
    """
    prints = fingerprints(stages)
    jobs = {
        stage.name: (stage, out / stage.name, {name: out / name for name in stage.inputs}, prints[stage.name])
        for stage in stages
        if not is_finished(out / stage.name, prints[stage.name])
    }
    done = set(prints) - set(jobs)
    progress(len(done), len(stages), "")
    while waiting := [stage for stage in stages if stage.name not in done]:
        ready = [stage for stage in waiting if done.issuperset(stage.inputs)]
        now = [stage.name for stage in ready if not stage.alone] or [ready[0].name]
        for name, _ in run_jobs(make_stage, {name: jobs[name] for name in now}, workers):
            done.add(name)
            progress(len(done), len(stages), name)
    return list(jobs)


def make_stage(stage: Stage, folder: Path, inputs: Inputs, fingerprint: str) -> None:
    """Make one stage; its folder is emptied if it holds another one."""
    if not record_of(folder, fingerprint):
        shutil.rmtree(folder, ignore_errors=True)
    record: dict[str, Any] = {"fingerprint": fingerprint}
    write_whole(folder / RECORD, json.dumps(record))
    began = time.monotonic()
    numbers = stage.make(folder, inputs, **stage.settings)
    if numbers is not None:
        write_whole(folder / NUMBERS, json.dumps(numbers))
    record["files"] = sorted(path.name for path in folder.iterdir() if path.name != RECORD)
    record["seconds"] = round(time.monotonic() - began, 1)
    write_whole(folder / RECORD, json.dumps(record))
