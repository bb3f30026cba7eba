"""Simulate the whole suite, and write closed-loop.md and its figures: `python docs/pages.py closed-loop`.

A run that is cut short resumes, as `quadsim bench` does.
"""

import json
import resource
import time
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from textwrap import fill

import matplotlib
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from pages import Page, Parts, row

import estimators
from estimators.networks.network import silenced
from estimators.networks.weights_file import load_network, save_network
from estimators.registry import NETWORKS
from quadsim.dataset.figures import STYLE
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import scenario_names
from quadsim.imu.spec import load_imu
from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.console import progress_bar
from quadsim.vehicle import GRAVITY, load_vehicle
from scenarios.bench import estimator_delay as loops
from scenarios.bench.breaking import DISTURBANCES, BreakingPoint, breaking_points
from scenarios.bench.cell import fly as fly_mission
from scenarios.bench.controllers import TRUTH
from scenarios.bench.flight_metrics import flight_metrics
from scenarios.bench.linear_bound import least_error
from scenarios.bench.pairs import ALL, paired_differences
from scenarios.bench.runner import Results, bench, suite_digest
from scenarios.bench.settings import FlightSettings, ScenarioChanges
from scenarios.bench.verdict import shown, total, verdict
from scenarios.demo import SLOW
from scenarios.report.publish import publish

OUT = Path(__file__).parents[1] / "reports" / "closed-loop"
SEEDS, BREAKING_SEEDS = 20, 10
LONG = ("hover", "figure-8", "dryden-moderate", "wind-8")
LONG_S = 100.0
SPEEDS_KNOWN = (np.inf, 0.3)
LONG_NAMES = (TRUTH, "att-snn-loihi", "att-rnn", "ekf-drag", "eskf", "mahony", "vqf")


@contextmanager
def timed(note: Path) -> Iterator[None]:
    """Add the time of this process and of its workers to a file, finished or not."""
    clock, before = time.perf_counter(), _cpu_seconds()
    try:
        yield
    finally:
        spent = json.loads(note.read_text()) if note.exists() else {"cpu_s": 0.0, "wall_s": 0.0}
        spent["cpu_s"] += _cpu_seconds() - before
        spent["wall_s"] += time.perf_counter() - clock
        note.write_text(json.dumps(spent))


def _cpu_seconds() -> float:
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def fly(
    name: str, scenarios: Sequence[str], names: Sequence[str], duration_s: float | None = None
) -> tuple[Results, float]:
    """A benchmark in a folder of its own, and the minutes of processor time that all its cells took."""
    folder = OUT / name
    folder.mkdir(parents=True, exist_ok=True)
    note = folder / f"time-{suite_digest()[:12]}.json"
    with timed(note), progress_bar(name, "cells") as progress:
        changes = ScenarioChanges(duration_s)
        results = bench(scenarios, names, folder, FlightSettings(SEEDS), changes, progress=progress)
    return results, json.loads(note.read_text())["cpu_s"] / 60


def suite_text(results: Results, minutes: float) -> str:
    """Size of the benchmark, and its cost."""
    s = results
    flights = len(results.cells) * SEEDS
    hours = SEEDS * len(s.estimators) * sum(each.duration_s for each in s.scenarios.values()) / 3600
    return (
        f"{len(s.scenarios)} scenarios × {len(s.estimators)} estimators × {SEEDS} seeds: {flights} flights, "
        f"{hours:.0f} hours\nof flight, in {minutes:.1f} minutes of processor time."
    )


def heat_map(results: Results) -> Figure:
    """Mean error of every estimator in every scenario, best estimators first; crashes in bold."""
    names = [s.estimator for s in verdict(results).standings if s.estimator not in results.unranked]
    scenarios = list(results.scenarios)
    rows = {(cell.estimator, cell.scenario): cell for cell in results.rows}
    error = np.array([[rows[e, s].error_deg or np.nan for e in names] for s in scenarios], dtype=float)
    figure = Figure(figsize=(9.6, 0.27 * len(scenarios) + 1.6), layout="constrained")
    axes = figure.subplots()
    axes.grid(visible=False)
    colours = matplotlib.colormaps["YlOrRd"].copy()
    colours.set_bad("#f2f2f2")
    picture = axes.imshow(error, norm=LogNorm(0.3, 30.0), cmap=colours, aspect="auto", alpha=0.8)
    for i, scenario in enumerate(scenarios):
        for j, name in enumerate(names):
            cell = rows[name, scenario]
            text = "–" if not np.isfinite(error[i, j]) else f"{error[i, j]:.1f}"
            crashes = f" ✕{cell.crashes}" if cell.crashes else ""
            weight = "bold" if crashes else "normal"
            axes.text(j, i, text + crashes, ha="center", va="center", fontsize=7, fontweight=weight)
    axes.set_xticks(range(len(names)), names, rotation=35, ha="left", fontsize=8)
    axes.set_yticks(range(len(scenarios)), scenarios, fontsize=8)
    axes.tick_params(top=True, labeltop=True, bottom=False, labelbottom=False, length=0)
    axes.spines[:].set_visible(False)
    bar = figure.colorbar(picture, label="error of roll and pitch [°]", fraction=0.02, pad=0.01)
    bar.set_ticks([0.3, 1, 3, 10, 30], labels=["0.3", "1", "3", "10", "30"])
    bar.ax.minorticks_off()
    return figure


def standing_rows(results: Results, without: Results, files: Mapping[str, str]) -> list[str]:
    """Estimators from best to worst over the whole suite, paired with the best on the same seeds.

    Args:
        results: Of the suite.
        without: Of the suite with silenced networks.
        files: Networks to the files of their silenced weights.
    """
    standings = [s.estimator for s in verdict(results).standings]
    best = standings[0]
    pairs = {
        (cell.estimator, cell.versus): cell
        for cell in paired_differences(results.flights)
        if (cell.scenario, cell.metric) == (ALL, "error_deg")
    }
    rows = []
    for name in standings:
        sums = total([cell for cell in results.rows if cell.estimator == name])
        pair, sign = (pairs[name, best], 1) if (name, best) in pairs else (pairs.get((best, name)), -1)
        difference = "–"
        if pair and pair.difference is not None:
            middle, half = sign * pair.difference, (_float(pair.high) - _float(pair.low)) / 2
            difference = f"{middle:+.2f} ± {half:.2f}"
        crashed = f"{sums.crashes} of {sums.flights}"
        silent, error = silenced_text(without, files.get(name)), shown(sums.error).removesuffix("°")
        rows.append(row(name, crashed, error, silent, difference, f"{sums.attitude:.2f}"))
    return rows


def _float(value: object) -> float:
    return value if isinstance(value, float) else np.nan


def breaking_rows(points: list[BreakingPoint]) -> list[str]:
    """The least level of each disturbance at which an estimator crashed."""
    names = list(dict.fromkeys(point.estimator for point in points))
    text = {(p.estimator, p.disturbance): p.text + (f", {p.cause}" if p.cause else "") for p in points}
    return [row(name, *(text[name, kind] for kind in DISTURBANCES)) for name in names]


class BiasedTruth:
    """The true roll and pitch with the error that the accelerometer's turn-on bias makes in hover."""

    rate_hz = 200.0

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Draw the bias of n vehicles."""
        spread = load_imu("adis16448").accel.turn_on / GRAVITY
        self._error = np.random.default_rng(0).normal(0.0, spread, (n, 2))

    def observe(self, quat: NDArray[np.float64]) -> None:
        """Take the truth."""
        self._true = roll_pitch_from_quat(quat)

    def update(self, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> NDArray[np.float64]:
        """The truth with the error."""
        return self._true + self._error


def bias_rows(results: Results) -> list[str]:
    """The row of `BiasedTruth`, in the form of `long_rows`."""
    truth = {cell.scenario: cell for cell in results.rows if cell.estimator == TRUTH}
    entries = []
    for name, scenario in results.scenarios.items():
        mission = Mission(scenario, BiasedTruth(), SEEDS)
        log, end = fly_mission(mission, 0)
        ours = flight_metrics(log, end, 200.0, mission.vehicle)
        ratio = ours.attitude_deg.mean() / _float(truth[name].attitude_deg)
        place = ours.position_m.mean() / _float(truth[name].position_m)
        entries.append(f"{ratio:.2f} ({ours.error_deg.mean():.2f}°, {place:.2f})")
    return [row("*truth with the error of the accelerometer's bias*", *entries)]


def bound_rows(results: Results) -> list[str]:
    """The rows of the best linear estimator, with its speed unknown and known to a standard deviation."""
    imu, vehicle = load_imu("adis16448"), load_vehicle("hummingbird")
    truth = {cell.scenario: _float(cell.attitude_deg) for cell in results.rows if cell.estimator == TRUTH}
    rows = []
    for speed_sd in SPEEDS_KNOWN:
        entries = []
        for name, scenario in results.scenarios.items():
            error = np.degrees(least_error(imu, vehicle, scenario, LONG_S, speed_sd))
            entries.append(f"{np.hypot(1.0, error / truth[name]):.2f} ({error:.2f}° RMS)")
        known = "speed unknown" if np.isinf(speed_sd) else f"speed known to {speed_sd:g} m/s"
        rows.append(row(f"*best possible, {known}*", *entries))
    return rows


def long_rows(results: Results, files: Mapping[str, str]) -> list[str]:
    """Crashes and attitude tracking over that of the truth, in the long flights; silenced networks last."""
    shown = {path: f"*{name}, silenced*" for name, path in files.items()}
    rows = {(cell.estimator, cell.scenario): cell for cell in results.rows}

    def entry(name: str, scenario: str) -> str:
        cell, truth = rows[name, scenario], rows[TRUTH, scenario]
        crashes = f", ✕ {cell.crashes}" if cell.crashes else ""
        if name == TRUTH:
            return f"{_float(truth.attitude_deg):.2f}°{crashes}"
        ratio = _float(cell.attitude_deg) / _float(truth.attitude_deg)
        place = _float(cell.position_m) / _float(truth.position_m)
        return f"{ratio:.2f} ({_float(cell.error_deg):.2f}°, {place:.2f}){crashes}"

    return [row(shown.get(name, name), *(entry(name, each) for each in LONG)) for name in results.estimators]


@cache
def attitude_loop() -> Sequence[loops.Response]:
    """The attitude loop of the hummingbird at several delays."""
    vehicle = load_vehicle("hummingbird")
    assert vehicle.controller is not None
    return loops.responses(vehicle, vehicle.controller)


def loop_price() -> list[str]:
    """What 15 ms cost, in a sentence."""
    none, paid = (next(r for r in attitude_loop() if r.delay_ms == delay) for delay in (0.0, 15.0))
    phase = none.margins.phase_deg - paid.margins.phase_deg
    gain = none.margins.gain_db - paid.margins.gain_db
    return [
        f"15 ms cost {phase:.0f}° of phase margin and {gain:.1f} dB of gain margin. "
        f"{paid.margins.phase_deg:.0f}° and {paid.margins.gain_db:.1f} dB are left, and a spare delay",
        f"of {paid.margins.delay_ms:.0f} ms. A design without delay could have a crossover "
        f"{100 * (none.redesigned / paid.redesigned - 1):.0f} % higher.",
    ]


def loop_rows(page: Page) -> list[str]:
    """The loop at each delay, with its picture."""
    found = attitude_loop()
    figure = loops.draw(found, title="hummingbird, gains designed for 15 ms")
    page.save(figure, "attitude-loop.png", colours=128)
    return [row(*each.values()) for each in loops.table(found)]


def silenced_files() -> dict[str, str]:
    """Each network of the suite to a file of its weights with output weights of zero."""
    OUT.mkdir(parents=True, exist_ok=True)
    found = {}
    for name in NETWORKS:
        weights = name.removesuffix("-loihi")
        config, tensors = load_network(weights)
        path = OUT / f"{weights}-silenced.safetensors"
        save_network(path, config, silenced(config, tensors))
        found[name] = str(path)
    return found


def silenced_text(results: Results, path: str | None) -> str:
    """Error and crashes of a silenced network; a dash for other estimators."""
    if path is None:
        return "–"
    sums = total([cell for cell in results.rows if cell.estimator == path])
    return f"{shown(sums.error)}, ✕ {sums.crashes}"


def values(page: Page, given: Namespace) -> Parts:
    """Measure everything, and draw."""
    names = [name for name in estimators.names() if name not in SLOW]
    files = silenced_files()
    results, minutes = fly("suite", scenario_names(), names)
    without, _ = fly("silenced", scenario_names(), sorted(set(files.values())))
    long_names = (*LONG_NAMES, *dict.fromkeys(files[name] for name in LONG_NAMES if name in files))
    long, _ = fly("long", LONG, long_names, LONG_S)
    with progress_bar("break", "points") as progress:
        points = breaking_points(
            list(DISTURBANCES), names, OUT / "suite", FlightSettings(BREAKING_SEEDS), progress=progress
        )
    publish(OUT / "suite", results, points)
    with matplotlib.rc_context(STYLE):
        page.save(heat_map(results), "heat-map.png", colours=128)
        loop = loop_rows(page)
    return {
        "verdict": verdict(results).headline,
        "conditions": fill(verdict(results).lines[0], 125),
        "suite": suite_text(results, minutes),
        "seeds": str(SEEDS),
        "breaking_seeds": str(BREAKING_SEEDS),
        "long_s": f"{LONG_S:g}",
        "standings": standing_rows(results, without, files),
        "breaking": breaking_rows(points),
        "long": [*long_rows(long, files), *bias_rows(long), *bound_rows(long)],
        "loop": loop,
        "price": loop_price(),
    }
