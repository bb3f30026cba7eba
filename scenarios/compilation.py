"""Compilation before the first flight, by a short run of every estimator on all cores."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from estimators.evaluation.comparison import evaluate
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe
from quadsim.runs.compiled import store
from quadsim.runs.console import progress_bar
from quadsim.runs.fingerprint import code_digest, fingerprint
from quadsim.runs.pool import run_jobs

from .bench.cell import FlightSettings
from .bench.runner import bench

FLIGHTS, LENGTH_S = 2, 1.0
"""Size of the generated dataset."""


def compile_estimators(names: Sequence[str], workers: int | None = None) -> None:
    """Compile the simulator and estimators, unless compiled code is up to date.

    Args:
        names: Estimators.
        workers: Number of processes, by default one per CPU.
    """
    done = store() / f"{fingerprint(code_digest('scenarios.bench.cell', 'estimators'), *names)[:12]}.compiled"
    if done.is_file():
        return
    with progress_bar("compile", "estimators") as bar, tempfile.TemporaryDirectory() as folder:
        bar(0, len(names), "simulator")
        flights = Path(folder) / "flights.zarr"
        generate(load_recipe("hummingbird"), FLIGHTS, LENGTH_S, flights, workers=1)
        jobs = {name: (name, Path(folder)) for name in names}
        for k, (name, _) in enumerate(run_jobs(use, jobs, workers), 1):
            bar(k, len(names), name)
    done.touch()


def use(name: str, folder: Path) -> None:
    """Run an estimator on a short dataset and in a short flight."""
    evaluate(open_dataset(folder / "flights.zarr"), [name])
    bench(["hover"], [name], folder / name, FlightSettings(FLIGHTS), {"duration_s": 0.1}, workers=1)
