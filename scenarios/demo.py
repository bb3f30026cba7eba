"""A small, real version of the whole chain: generate flights, score estimators on them, fly them, report."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import NamedTuple, TypeAlias

import estimators
from quadsim.dataset.generation import generate
from quadsim.flight.recipe import load_recipe
from quadsim.runs.files import write_csv

from .bench.offline import OfflineRow, offline_errors, table_of
from .bench.pairs import paired_differences
from .bench.runner import Progress, Results, bench
from .bench.settings import FlightSettings
from .report.flight_picture import cover
from .report.page import ClosedLoopSection, OfflineSection, write_report

SCENARIOS = ("hover", "step", "wind-gust", "initial-tilt")
DURATION_S = 30.0
"""Length of the generated flights [s]."""
SLOW = ("ukf-filterpy",)
"""Left out of the small version: the same numbers as the compiled filter, in ten times the time."""
RECORDED = (
    "Every estimator run over {flights} generated flights of {duration_s:g} s, tilts up to 45°, without a "
    "loop: mean absolute error of roll and pitch, pooled, over the flights. Start: whether the initial "
    "attitude was given; networks are never given it. Silenced: the same network with output weights of zero."
)

Stage: TypeAlias = Callable[[str, str], AbstractContextManager[Progress | None]]
"""stage(title, unit): a progress bar for one part of the work."""


class Demo(NamedTuple):
    """Results, and the report that shows them."""

    report: Path
    results: Results
    offline: list[OfflineRow]
    note: str  #: what was left out and why; empty if nothing


def demo(
    out: str | Path,
    *,
    flights: int = 6,
    seeds: int = 5,
    seed: int = 0,
    workers: int | None = None,
    stage: Stage = lambda title, unit: nullcontext(),
) -> Demo:
    """Generate a few flights, score every estimator on them, fly it through four scenarios, write the report.

    Args:
        out: Folder for everything.
        flights: Flights to generate.
        seeds: Flights of each estimator in each scenario.
        seed: Seed of everything random.
        workers: Processes, by default one for each CPU.
        stage: Makes the progress bars.

    Raises:
        ValueError: For a bad argument.
        OSError: If a file cannot be written.
    """
    out = Path(out).expanduser()
    names = [name for name in estimators.names() if name not in SLOW]
    recipe, path = load_recipe("hummingbird"), out / "flights.zarr"
    with stage("generate", "flights") as bar:
        generate(recipe, flights, DURATION_S, path, seed=seed, workers=workers, progress=bar, overwrite=True)
    with stage("fly", "cells") as bar:
        results = bench(SCENARIOS, names, out, FlightSettings(seeds, seed), workers=workers, progress=bar)
    offline = offline_errors(path, names)
    write_csv(out / "recorded.csv", table_of(offline))
    still, note = cover(results.cells)
    pairs = paired_differences(results.flights)
    write_csv(out / "pairs.csv", pairs)
    recorded = OfflineSection(table_of(offline), RECORDED.format(flights=flights, duration_s=DURATION_S))
    csv = ["results.csv", "flights.csv", "pairs.csv", "recorded.csv"]
    section = ClosedLoopSection(results, pairs, still=still)
    return Demo(write_report(out / "report.html", section, recorded, csv=csv), results, offline, note)
