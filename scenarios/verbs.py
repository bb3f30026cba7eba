"""Implementation of the verbs `bench`, `report` and `demo`."""

from collections.abc import Sequence
from pathlib import Path

from estimators.evaluation.comparison import evaluate
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe
from quadsim.runs.console import output, progress_bar, say
from quadsim.runs.files import alone
from quadsim.runs.record import recorded

from .bench.cell import FlightSettings
from .bench.controllers import LEFT_OUT, contenders, default_estimators
from .bench.experiment import load_experiment
from .bench.results import Results, load_results
from .bench.runner import Changes, bench
from .bench.verdict import verdict
from .compilation import compile_estimators
from .report.evaluation import columns, evaluation_notes, recorded_section
from .report.leaderboard import closed_loop_flights, find_entries, standing, write_leaderboard
from .report.page import publish, write_report
from .report.terminal import breaking_table, rows_table, standings_table
from .task.entry import FILE
from .task.run_task import run_task
from .task.specification import load_task

DEMO = ("hover", "step", "wind-gust", "initial-tilt")
"""Scenarios of `quadsim demo`."""
DEMO_S = 30.0
"""Length of the generated flights in `quadsim demo` [s]."""
SLOW_FLIGHTS = 1
"""Number of generated flights on which filterpy's filters are scored."""


def run_bench(
    out: Path,
    experiment: str,
    scenarios: Sequence[str] | None,
    names: Sequence[str] | None,
    controllers: Sequence[str],
    changes: Changes,
    *,
    seeds: int | None,
    seed: int | None,
    rate_hz: float,
    tuning: str | None,
    workers: int | None,
) -> None:
    """Fly an experiment, write tables and report, and print the verdict.

    Raises:
        ValueError: An argument or a file is invalid, or no cell ran.
        OSError: The results cannot be written.
    """
    chosen = load_experiment(experiment)
    if chosen.seed is not None and seed is not None:
        raise ValueError(f"{experiment} has its own seed: omit --seed")
    settings = FlightSettings(seeds or chosen.seeds, chosen.seed or seed or 0, rate_hz, tuning)
    if not names:
        left_out = ", ".join(f"{name} ({why})" for name, why in LEFT_OUT.items())
        say(f"Not included: {left_out}. To include one, give it by --estimator.")
    flown = contenders(names or default_estimators(), controllers)
    with alone(out):
        with recorded(out), progress_bar("fly", "cells") as progress:
            results = bench(
                scenarios or None, flown, out, settings, changes,
                experiment=chosen, workers=workers, progress=progress,
            )  # fmt: skip
        page = publish(out, results)
    say(f"{results.cost}.")
    print_verdict(page, results)
    if all(cell.reason for cell in results.cells):
        raise ValueError(f"no cell ran; {results.cells[0].estimator}: {results.cells[0].reason}")


def run_entries(
    out: Path, task: str, sources: Sequence[str], recordings: Path | None, workers: int | None
) -> None:
    """Run a task for entries and write the leaderboard of all entries in the folder.

    Raises:
        ValueError: An argument or a file is invalid, or an entry does not exist.
        OSError: A file cannot be written.
    """
    wanted, out = load_task(task), out.expanduser()
    with alone(out):
        with recorded(out), progress_bar("run", "steps") as progress:
            entries = run_task(
                wanted, sources, out, recordings=recordings, workers=workers, progress=progress
            )
        for entry in entries:
            for reason in entry.reasons:
                say(f"{entry.card.name} is not ranked: it {reason}", "yellow")
        report_entries([out], out / "leaderboard.html")


def has_entries(folder: Path) -> bool:
    """Return whether a folder contains entries of a task."""
    return any(folder.glob(FILE)) or any(folder.glob(f"*/{FILE}"))


def report_entries(folders: Sequence[Path], out: Path) -> None:
    """Write the leaderboard of the entries in folders, and print the leader of each track."""
    entries = find_entries(folders)
    page = write_leaderboard(out, entries)
    leaders = []
    for track in sorted({each.card.track for each in entries}):
        own = [each for each in entries if each.card.track == track]
        match standing(own, closed_loop_flights(own)):
            case []:
                leaders.append(f"{track}: no entry is ranked")
            case [only]:
                leaders.append(f"{track}: {only} is the only ranked entry")
            case [first, *others]:
                leaders.append(f"{track}: {first} leads ({len(others) + 1} entries are ranked)")
    say(f"{page}: {'; '.join(leaders)}")


def report_benchmark(folder: Path, out: Path | None = None) -> None:
    """Write the report of finished flights again; raise ValueError if there are none."""
    results = load_results(folder)
    print_verdict(publish(folder, results, out), results)


def demo(out: Path, flights: int, seeds: int, seed: int, workers: int | None) -> None:
    """Generate flights, score every estimator on them, and fly it in four scenarios."""
    names = default_estimators()
    recipe = load_recipe("hummingbird")
    path = out.expanduser() / "flights.zarr"
    with alone(out):
        compile_estimators(names, workers)
        with progress_bar("generate", "flights") as bar:
            generate(recipe, flights, DEMO_S, path, seed=seed, workers=workers, progress=bar, overwrite=True)
        with progress_bar("evaluate", "runs") as bar:
            scored = evaluate(open_dataset(path), names, slow_flights=SLOW_FLIGHTS, progress=bar)
        with progress_bar("fly", "cells") as bar:
            results = bench(DEMO, names, out, FlightSettings(seeds, seed), workers=workers, progress=bar)
        caption = f"{flights} simulated flights of {DEMO_S:g} s, scored outside the loop."
        output.print(rows_table(columns(scored), caption))
        page = write_report(
            out.expanduser() / "report.html",
            results,
            recorded_section(scored, " ".join([caption, *evaluation_notes(scored)])),
            files=["results.csv", "flights.parquet"],
        )
    print_verdict(page, results)


def print_verdict(page: Path, results: Results) -> None:
    """Print the verdict: the table, then the path of the report with the headline, then remarks."""
    judged = verdict(results)
    output.print(standings_table(judged))
    if results.axes.keys() <= results.experiment.sweeps.keys():
        output.print(breaking_table(results))
    if not results.experiment.axes:  # which fly vehicles and IMUs without tuned parameters
        warn(results)
    for line in [f"{page}: {judged.headline}", *judged.lines]:
        say(line)


def warn(results: Results) -> None:
    """Print warnings about the results."""
    for line in results.warnings:
        say(f"warning: {line}", "yellow")
