"""Size of the report of a complete suite, and the time that it takes to make.

    python -m benchmarks.bench_report [--seeds 20] [--report FOLDER] [--out speed.csv]

Every shipped scenario with every estimator. The results are made up, so that nothing is simulated: smooth
motion, estimates with drifting and white errors, crashes in one flight of 25. The goals for 26 scenarios × 14
estimators × 20 seeds are at most 5 MB, and 1 s of CPU time for pairs and page together.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TypeVar

import numpy as np

import estimators
from quadsim.flight.mission import CAUSES
from quadsim.flight.scenario import load_scenario, scenario_names
from scenarios.bench.cell import Cell
from scenarios.bench.flight_metrics import FlightMetrics, FlightRow, Log, error_histogram, log_dtype
from scenarios.bench.pairs import paired_differences
from scenarios.bench.runner import Results
from scenarios.bench.series import decimation, pack_series
from scenarios.bench.settings import FlightSettings
from scenarios.bench.signals import signal_names
from scenarios.report.flight_picture import cover
from scenarios.report.page import ClosedLoopSection, write_report

from .table import show

Made = TypeVar("Made")


def smooth(rng: np.random.Generator, t: np.ndarray, columns: int, size: float) -> np.ndarray:
    """Sums of three sines of 0.05 to 1 Hz, (T, columns)."""
    rate, phase = (
        2.0 * np.pi * rng.uniform(0.05, 1.0, (3, columns)),
        rng.uniform(0.0, 2.0 * np.pi, (3, columns)),
    )
    return size * np.sin(rate * t[:, None, None] + phase).sum(axis=1)


def made_up_log(rng: np.random.Generator, duration_s: float, rate_hz: float) -> Log:
    """One flight (T,); what the report does not show of it stays zero."""
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    log = np.zeros(t.size, log_dtype(4))
    log["target"] = smooth(rng, t, 3, 1.0)
    log["position"] = log["target"] + smooth(rng, t, 3, 0.05)
    log["euler"] = smooth(rng, t, 3, 0.1)
    log["estimate"] = log["euler"][:, :2] + smooth(rng, t, 2, 0.01) + rng.normal(0.0, 0.002, (t.size, 2))
    return log


def made_up_signals(rng: np.random.Generator, samples: int, dt: float) -> dict[str, np.ndarray]:
    """What is behind an estimate: smooth, and readings and commands with noise."""
    t, names = np.arange(samples) * dt, signal_names(4)
    noise = [0.1 if name.startswith(("gyro", "accel", "rotor")) else 0.0 for name in names]
    values = smooth(rng, t, len(names), 1.0) + rng.normal(0.0, 1.0, (samples, len(names))) * noise
    return dict(zip(names, values.T, strict=True))


def made_up_flight(rng: np.random.Generator, scenario: str, estimator: str, seed: int) -> FlightRow:
    cause = str(rng.choice(CAUSES[1:])) if rng.random() < 0.04 else ""
    values = {each.name: float(rng.lognormal()) for each in fields(FlightMetrics)}
    return FlightRow(scenario, estimator, seed, cause, 20.0, **values)


def made_up_results(seeds: int) -> Results:
    rng, settings = np.random.default_rng(0), FlightSettings(seeds)
    scenarios = {name: load_scenario(name) for name in scenario_names()}
    cells = []
    for name, scenario in scenarios.items():
        for estimator in estimators.names():
            log = made_up_log(rng, scenario.duration_s, settings.rate_hz)
            flights = [made_up_flight(rng, name, estimator, seed) for seed in range(seeds)]
            histogram = error_histogram(log[None], np.array([log.size])).tolist()
            signals = made_up_signals(rng, -(-log.size // decimation(settings.rate_hz)), 0.04)
            series = pack_series(log, settings.rate_hz, signals)
            cells.append(Cell(name, estimator, "", "", flights, histogram, series))
    return Results(scenarios, estimators.names(), settings, cells)


def measure(seeds: int, path: Path) -> list[dict[str, str]]:
    """Write a report; wall and CPU time of its parts, and its size after each."""
    results, rows = made_up_results(seeds), []
    path.parent.mkdir(parents=True, exist_ok=True)

    def timed(name: str, make: Callable[[], Made]) -> Made:
        wall, cpu = time.perf_counter(), time.process_time()
        made = make()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        size = f"{path.stat().st_size / 1e6:.2f}" if path.exists() else ""
        rows.append({"part": name, "wall_s": f"{wall:.2f}", "cpu_s": f"{cpu:.2f}", "size_MB": size})
        return made

    path.unlink(missing_ok=True)
    pairs = timed("paired differences", lambda: paired_differences(results.flights))
    timed("page", lambda: write_report(path, ClosedLoopSection(results, pairs)))
    picture, _ = timed("picture of a flight", lambda: cover(results.cells))
    timed("page with it", lambda: write_report(path, ClosedLoopSection(results, pairs, still=picture)))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="flights in each cell")
    parser.add_argument("--report", type=Path, default=Path("reports/bench"), help="folder for the report")
    parser.add_argument("--out", type=Path, help="also write the table as CSV")
    arguments = parser.parse_args()
    path = arguments.report / "report.html"
    show(f"report of {len(scenario_names())} scenarios", measure(arguments.seeds, path), arguments.out)
    print(path)


if __name__ == "__main__":
    main()
