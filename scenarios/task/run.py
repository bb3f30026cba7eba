"""Run a task for entries, and write the file of each; a run that was stopped goes on where it was."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter

from estimators import create
from estimators.evaluation.comparison import errors_of
from estimators.metrics import inclination_rmse
from estimators.running import run_checked
from quadsim.runs.console import Bar
from quadsim.runs.files import alone, write_whole
from quadsim.runs.fingerprint import code_digest, fingerprint
from quadsim.runs.pool import run_all

from ..bench.cell import FlightSettings
from ..bench.results import records
from ..bench.runner import bench, flight_code
from .data import Group, differing, given_start, groups, make_data
from .entry import ENTRY, FILE, Card, Entry, LoopFlight, PartScore, card_of, digest_of_entry
from .examination import Examined, deadline, examine, opened_files, watching
from .specification import BROAD, Task

EXAMINED, SCORE = TypeAdapter(Examined), TypeAdapter(PartScore)
LONGEST = 20.0
"""Times the length of the allowed time after which a part is ended."""


class Entered(NamedTuple):
    """An entry that runs."""

    card: Card
    digest: str
    folder: Path


def run_task(
    task: Task,
    sources: Sequence[str],
    out: Path,
    *,
    recordings: Path | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Bar = lambda done, total, note="": None,
) -> list[Entry]:
    """Run a task for entries; each has a folder with its `entry.json`.

    Args:
        task: The task.
        sources: Entries: names, weights or classes, as `estimators.create` takes them.
        out: Folder for all of them, and for the data.
        recordings: Folder of BROAD, as its authors publish it; None: that part is left out.
        workers: Processes, by default one for each CPU.
        executor: Where to run in place of processes of our own.
        progress: A bar.

    Raises:
        ValueError: A bad argument, two entries of one name, or a folder that another process writes.
        OSError: Something cannot be written.
    """
    entered = []
    for source in dict.fromkeys(sources):
        card = card_of(source, task.rate_hz)
        entered.append(Entered(card, digest_of_entry(source), out / card.name))
    data = out / "data"
    if len({data, *(each.folder for each in entered)}) <= len(entered):
        named = ", ".join(each.card.source for each in entered)
        raise ValueError(f'two entries have one name, or one is called "data": {named}')
    with alone(out):
        digests = make_data(task, data, recordings, workers, progress)
        code = fingerprint(flight_code(), code_digest("scenarios.task.run"))
        about = {"version": task.version, "task": task.fingerprint, "code": code, "data": digests}
        examined = _examined(task, entered, data, about, progress)
        scored = _scored(task, entered, examined, data, about, workers, executor, progress)
        entries = []
        for each in entered:
            found, flown, flaws = examined[each.folder], (), list[str]()
            if found.runs:
                run = partial(progress, note=f"{each.card.name}, closed loop")
                flown, flaws = fly_entry(task, each, workers, executor, run)
            parts = scored.get(each.folder, {})
            flaws += [f"{part.flaw} ({name})" for name, part in parts.items() if part.flaw]
            flaws += [
                f"ran on data that differ from the task's ({name})" for name in differing(task, digests)
            ]
            entry = Entry(
                **about, entry=each.digest, card=each.card, cost=found.cost, parts=parts,
                flights=flown, reasons=tuple(dict.fromkeys([*found.reasons, *flaws])),
            )  # fmt: skip
            write_whole(each.folder / FILE, ENTRY.dump_json(entry, indent=1))
            entries.append(entry)
    return entries


def _examined(
    task: Task, entered: Sequence[Entered], data: Path, about: Mapping[str, Any], progress: Bar
) -> dict[Path, Examined]:
    """What was found of each entry, one after the other: times are measured."""
    found = {}
    flights = next(groups(task, task.parts[0], data)).flights
    for k, each in enumerate(entered):
        progress(k, len(entered), f"{each.card.name}, checks")
        file = _file(each, "checks", about)
        if (stored := _stored(file, EXAMINED)) is None:
            stored = examine(task, each.card, data, flights)
            write_whole(file, EXAMINED.dump_json(stored))
        found[each.folder] = stored
    return found


def _scored(
    task: Task,
    entered: Sequence[Entered],
    examined: Mapping[Path, Examined],
    data: Path,
    about: Mapping[str, Any],
    workers: int | None,
    executor: Executor | None,
    progress: Bar,
) -> dict[Path, dict[str, PartScore]]:
    """Errors of each entry on each part."""
    by_name = {each.card.name: each for each in entered if examined[each.folder].runs}
    files = {(name, part): _file(each, part, about) for name, each in by_name.items() for part in task.parts}
    done = {key: stored for key, file in files.items() if (stored := _stored(file, SCORE)) is not None}
    jobs = {key: (task, key[1], by_name[key[0]].card, data) for key in files if key not in done}
    for key, score in run_all(score_part, jobs, workers, executor, apart=workers != 1):
        if isinstance(score, BaseException):  # the worker itself died
            score = PartScore(flaw=f"did not run: {type(score).__name__}: {score}")
        else:
            write_whole(files[key], SCORE.dump_json(score))
        done[key] = score
        progress(len(done), len(files), ", ".join(key))
    return {each.folder: {part: done[name, part] for part in task.parts} for name, each in by_name.items()}


def _file(entered: Entered, what: str, about: Mapping[str, Any]) -> Path:
    """Where a finished run of an entry is: on a part of the data, or of the checks."""
    data = about["data"].get(what)
    digest = fingerprint(what, about["task"], about["code"], data, entered.digest, asdict(entered.card))
    return entered.folder / "runs" / f"{what}-{digest[:16]}.json"


def _stored(file: Path, adapter: TypeAdapter[Any]) -> Any:
    """What an earlier run wrote; None where there is nothing whole."""
    try:
        return adapter.validate_json(file.read_bytes())
    except (OSError, ValueError):
        return None


def score_part(task: Task, name: str, card: Card, data: Path) -> PartScore:
    """Errors of an entry on a part."""
    found = list(groups(task, name, data))
    values: dict[str, float] = {}
    flaws: list[str] = []
    if not found:
        return PartScore(note="no folder of recordings was given")
    if "airframe" in card.given and any(group.vehicle is None for group in found):
        return PartScore(note="there is no airframe to be given")
    for group in found:
        try:
            values |= _errors(task, card, group, data, flaws)
        except (ValueError, OSError) as error:
            return PartScore(values, "it failed", f"did not run: {error}")
    note = ""
    if name == BROAD and len(values) < task.broad_trials:
        note = f"{len(values)} of {task.broad_trials} trials"
    return PartScore(values, note, "; ".join(dict.fromkeys(flaws)))


def _errors(task: Task, card: Card, group: Group, data: Path, flaws: list[str]) -> dict[str, float]:
    """Errors on one group of flights, by their names; what speaks against the entry is added to `flaws`."""
    flights = given_start(group) if "initial attitude" in card.given else group.flights
    others = {name: value for name, value in flights.readings.others.items() if name in card.given}
    readings = flights.readings._replace(**dict.fromkeys(flights.readings.others))._replace(**others)
    allowed_s = flights.truth[..., 0].size * task.most_ms / 1e3
    late = f"took more than {task.most_ms:g} ms per sample"
    with watching(data) as opened, deadline(LONGEST * max(allowed_s, 6.0), late):
        vehicle = group.vehicle if "airframe" in card.given else None
        made = create(card.source, card.rate_hz, vehicle=vehicle)
        estimate, _ = run_checked(made, readings, flights.start, flights.quat)
    flaws += opened_files(opened)
    if flaw := errors_of(estimate, flights.truth)["flaw"]:
        flaws.append(flaw)
    return dict(zip(group.names, inclination_rmse(estimate, flights.truth).sequences.tolist(), strict=True))


def fly_entry(
    task: Task, each: Entered, workers: int | None, executor: Executor | None, progress: Any
) -> tuple[tuple[LoopFlight, ...], list[str]]:
    """The flights of an entry in closed loop, and why it must not be ranked."""
    experiment = task.experiment(each.card.knowledge)
    settings = FlightSettings(experiment.seeds, experiment.seed or 0, task.rate_hz)
    results = bench(
        None, [each.card.source], each.folder / "closed-loop", settings,
        experiment=experiment, workers=workers, executor=executor, progress=progress,
    )  # fmt: skip
    names = [each.name for each in fields(LoopFlight)]
    flown = tuple(LoopFlight(**row._asdict()) for row in records(results.flights.reindex(columns=names)))
    flaws = list(dict.fromkeys(cell.flaw for cell in results.cells if cell.flaw))
    if failed := [cell.reason for cell in results.cells if cell.reason]:
        flaws.insert(0, f"did not fly in {len(failed)} of {len(results.cells)} scenarios: {failed[0]}")
    return flown, flaws
