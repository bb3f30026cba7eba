"""Stages: parts of the work, each with its own folder.

A stage is a function with arguments. For an argument that is another stage, the function receives its folder.
The fingerprint of a stage covers code, arguments and input stages. If the fingerprint has not changed, a
finished stage is read from its folder, and an interrupted one continues (a training continues from its
checkpoint). Otherwise, the stage starts in an empty folder.
"""

import json
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from quadsim.runs.files import write_whole
from quadsim.runs.fingerprint import code_digest, fingerprint
from quadsim.runs.pool import run_jobs

RECORD, NUMBERS = "stage.json", "numbers.json"
FLIGHTS, WEIGHTS, TUNING = "flights.zarr", "best.safetensors", "tuned.toml"

Numbers = dict[str, Any]
"""Measurements of a stage, as JSON data."""
Progress = Callable[[int, int, str], None]
"""Called as progress(finished stages, all stages, name of the last one)."""


@dataclass(frozen=True, eq=False)
class Stage:
    """A part of the work."""

    name: str
    make: Callable[..., Numbers | None]
    """Function at module level, called as make(folder, **arguments). Its result is stored in `NUMBERS`."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Everything else that the files depend on: JSON data, and stages whose files are read."""
    alone: bool = False
    """Whether no other stage may run at the same time, because the stage measures time."""
    packages: tuple[str, ...] = ()
    """Packages whose whole code counts, because the stage loads their modules by name."""

    @cached_property
    def inputs(self) -> list["Stage"]:
        """The stages among its arguments."""
        found: list[Stage] = []
        _with_stages(self.arguments, found.append)
        return found

    @cached_property
    def fingerprint(self) -> str:
        """Digest of code and arguments."""
        code = self.make.__qualname__, code_digest(self.make.__module__, *self.packages)
        arguments = _with_stages(self.arguments, lambda stage: stage.fingerprint)
        return fingerprint(self.name, *code, arguments)[:16]

    def record(self, out: Path) -> dict[str, Any]:
        """Return the record of the stage below a folder.

        The record is empty if the stage was not started, and has "seconds" if it is finished.
        """
        try:
            record = json.loads((out / self.name / RECORD).read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError):
            return {}
        return record if record.get("fingerprint") == self.fingerprint else {}

    def is_finished(self, out: Path) -> bool:
        """Return whether the stage is finished below a folder and all its files exist."""
        record = self.record(out)
        return "seconds" in record and all((out / self.name / file).exists() for file in record["files"])


def _with_stages(value: Any, replacement: Callable[[Stage], Any]) -> Any:
    """Nested arguments with something in place of every stage."""
    if isinstance(value, Stage):
        return replacement(value)
    if isinstance(value, Mapping):
        return {key: _with_stages(each, replacement) for key, each in value.items()}
    return [_with_stages(each, replacement) for each in value] if isinstance(value, list | tuple) else value


def with_inputs(stages: Mapping[str, Stage], wanted: Iterable[str]) -> list[Stage]:
    """Return stages and all their inputs, in the order of `stages`."""
    needed = set(wanted)
    for name in reversed(list(stages)):
        if name in needed:
            needed.update(each.name for each in stages[name].inputs)
    return [stage for name, stage in stages.items() if name in needed]


def run_stages(
    stages: Sequence[Stage],
    out: Path,
    workers: int | None = None,
    progress: Progress = lambda done, total, note: None,
) -> list[str]:
    """Run missing stages; independent stages run in parallel.

    Args:
        stages: Required stages, inputs first.
        out: Folder for the folders of the stages.
        workers: Processes, by default one for each CPU; 1 stays in this process.
        progress: Called after each stage.

    Returns:
        Names of the stages that were run.

    Raises:
        ChildProcessError: A worker process died. Finished stages are kept.
    """
    missing = [stage for stage in stages if not stage.is_finished(out)]
    waiting = list(missing)
    progress(len(stages) - len(waiting), len(stages), "")
    while waiting:
        ready = [stage for stage in waiting if not {*stage.inputs} & {*waiting}]
        now = [stage for stage in ready if not stage.alone] or ready[:1]
        for stage, _ in run_jobs(make_stage, {stage: (stage, out) for stage in now}, workers):
            waiting.remove(stage)
            progress(len(stages) - len(waiting), len(stages), stage.name)
    return [stage.name for stage in missing]


def make_stage(stage: Stage, out: Path) -> None:
    """Run one stage; empty its folder if it contains another one."""
    folder = out / stage.name
    if not stage.record(out):
        shutil.rmtree(folder, ignore_errors=True)
    record: dict[str, Any] = {"fingerprint": stage.fingerprint}
    write_whole(folder / RECORD, json.dumps(record))
    began = time.monotonic()
    numbers = stage.make(folder, **_with_stages(stage.arguments, lambda each: out / each.name))
    if numbers is not None:
        write_whole(folder / NUMBERS, json.dumps(numbers))
    record["files"] = sorted(path.name for path in folder.iterdir() if path.name != RECORD)
    record["seconds"] = round(time.monotonic() - began, 1)
    write_whole(folder / RECORD, json.dumps(record))
