"""Running of a task for entries; a run that was stopped can be resumed."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from estimators import create
from estimators.evaluation.comparison import errors_of
from estimators.metrics import inclination_rmse
from estimators.running import run_checked
from quadsim.runs.console import Bar
from quadsim.runs.files import alone, write_whole
from quadsim.runs.fingerprint import code_digest, fingerprint
from quadsim.runs.pool import run_stored

from ..bench.cell import FlightSettings
from ..bench.results import records
from ..bench.runner import bench, flight_code
from .entry import ENTRY, FILE, Card, Entry, LoopFlight, PartScore, card_of, digest_of_entry
from .examination import Examined, deadline, examine, opened_files, watching
from .specification import BROAD, Task
from .task_data import Group, differing, given_start, groups, make_data

EXAMINED, SCORE = TypeAdapter(Examined), TypeAdapter(PartScore)
LONGEST = 20.0
"""Multiple of the time limit after which a part is stopped."""


def run_task(
    task: Task,
    sources: Sequence[str],
    out: Path,
    *,
    recordings: Path | None = None,
    workers: int | None = None,
    progress: Bar = lambda done, total, note="": None,
) -> list[Entry]:
    """Run a task for entries; each has a folder with its `entry.json`.

    Args:
        task: The task.
        sources: Entries: names, weights or classes, as for `estimators.create`.
        out: Folder for all of them, and for the data.
        recordings: Folder of BROAD, as published by its authors; None leaves this part out.
        workers: Number of processes, by default one per CPU.
        progress: A progress bar.

    Raises:
        ValueError: An argument is invalid, two entries have the same name, or another process is writing to
            `out`.
        OSError: A file cannot be written.
    """
    cards = [card_of(source, task.rate_hz) for source in dict.fromkeys(sources)]
    if len({"data", *(card.name for card in cards)}) <= len(cards):
        named = ", ".join(card.source for card in cards)
        raise ValueError(f'two entries have one name, or one is called "data": {named}')
    with alone(out):
        digests = make_data(task, out / "data", recordings, workers, progress)
        code = fingerprint(flight_code(), code_digest("scenarios.task.run_task"))
        about = {"version": task.version, "task": task.fingerprint, "code": code, "data": digests}
        return [_run_entry(task, card, out, about, workers, progress) for card in cards]


def _run_entry(
    task: Task,
    card: Card,
    out: Path,
    about: Mapping[str, Any],
    workers: int | None,
    progress: Bar,
) -> Entry:
    """Check an entry, score it on each part of the data, fly it, and write its file."""
    folder, data, entry = out / card.name, out / "data", digest_of_entry(card.source)

    def file_of(what: str) -> Path:
        """Return the file of a finished run on a part of the data, or of the checks."""
        given = what, about["task"], about["code"], about["data"].get(what), entry, asdict(card)
        return folder / "runs" / f"{what}-{fingerprint(*given)[:16]}.json"

    progress(0, len(task.parts), f"{card.name}, checks")
    checks = {file_of("checks"): (task, card, data)}
    ((_, found),) = run_stored(examine, checks, EXAMINED, workers=1)
    assert isinstance(found, Examined)
    files = {file_of(part): part for part in task.parts if found.runs}
    jobs = {file: (task, part, card, data) for file, part in files.items()}
    parts, flown, reasons = dict[str, PartScore](), (), list(found.reasons)
    for file, score in run_stored(score_part, jobs, SCORE, workers, apart=workers != 1):
        if isinstance(score, BaseException):  # the worker itself died
            score = PartScore(flaw=f"did not run: {type(score).__name__}: {score}")
        parts[files[file]] = score
        progress(len(parts), len(files), f"{card.name}, {files[file]}")
    if found.runs:
        run = partial(progress, note=f"{card.name}, closed loop")
        flown, flaws = fly_entry(task, card, folder / "closed-loop", workers, run)
        reasons += flaws
    parts = {part: parts[part] for part in files.values()}
    reasons += [f"{score.flaw} ({part})" for part, score in parts.items() if score.flaw]
    reasons += [
        f"ran on data that differ from the task's ({part})" for part in differing(task, about["data"])
    ]
    done = Entry(
        **about, entry=entry, card=card, cost=found.cost, parts=parts, flights=flown,
        reasons=tuple(dict.fromkeys(reasons)),
    )  # fmt: skip
    write_whole(folder / FILE, ENTRY.dump_json(done, indent=1))
    return done


def score_part(task: Task, name: str, card: Card, data: Path) -> PartScore:
    """Return the errors of an entry on a part."""
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
    """Return the errors on one group of flights by name; add flaws of the entry to `flaws`."""
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
    task: Task, card: Card, out: Path, workers: int | None, progress: Any
) -> tuple[tuple[LoopFlight, ...], list[str]]:
    """Return the flights of an entry in closed loop, and why it must not be ranked."""
    experiment = task.experiment(card.knowledge)
    settings = FlightSettings(experiment.seeds, experiment.seed or 0, task.rate_hz)
    results = bench(
        None, [card.source], out, settings, experiment=experiment, workers=workers, progress=progress
    )
    names = [each.name for each in fields(LoopFlight)]
    flown = tuple(LoopFlight(**row._asdict()) for row in records(results.flights.reindex(columns=names)))
    flaws = list(dict.fromkeys(cell.flaw for cell in results.cells if cell.flaw))
    if failed := [cell.reason for cell in results.cells if cell.reason]:
        flaws.insert(0, f"did not fly in {len(failed)} of {len(results.cells)} scenarios: {failed[0]}")
    return flown, flaws
