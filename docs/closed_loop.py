"""Fly the suite, long flights and breaking points, for results.md: `python docs/pages.py closed-loop`.

A run that is cut short resumes, as `quadsim bench` does.
"""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill

import matplotlib
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from pages import Part, Values, row

from estimators.registry import NETWORKS
from quadsim.control.gains import design, loop_margins
from quadsim.runs.console import progress_bar
from quadsim.vehicle import load_vehicle
from scenarios.bench.cell import FlightSettings
from scenarios.bench.controllers import TRUTH, default_estimators
from scenarios.bench.experiment import Experiment, load_experiment
from scenarios.bench.recommendation import recommendation
from scenarios.bench.results import Results
from scenarios.bench.runner import bench
from scenarios.bench.verdict import Verdict, conditions, shown, verdict
from scenarios.report.page import publish

OUT = Path(__file__).parents[1] / "reports" / "closed-loop"
SEEDS = 20
SUITE, BREAKING = load_experiment("suite"), load_experiment("breaking-points")
LONG = ("hover", "figure-8", "dryden-moderate", "wind-8")
LONG_S = 100.0
LONG_NAMES = (TRUTH, "att-snn-loihi", "att-rnn", "ekf-drag", "eskf", "mahony", "vqf")
LEVEL = f"{Path(__file__).with_name('level.py')}:Level"
SHOWN_SWEEPS = ("constant wind", "step of the gyro bias", "lost samples")
DELAYS_MS = (0, 5, 15, 30, 60, 100)


def fly(
    name: str,
    experiment: Experiment,
    names: Sequence[str],
    scenarios: Sequence[str] | None = None,
    seeds: int = SEEDS,
    changes: Mapping[str, object] | None = None,
) -> Results:
    """An experiment in a folder of its own."""
    with progress_bar(name, "cells") as progress:
        return bench(
            scenarios, names, OUT / name, FlightSettings(seeds), changes or {},
            experiment=experiment, progress=progress,
        )  # fmt: skip


def heat_map(results: Results, names: Sequence[str]) -> Figure:
    """Mean error of every estimator in every scenario, best estimators first; crashes in bold."""
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
            crashes = rows[name, scenario].crashes
            text = "–" if np.isnan(error[i, j]) else f"{error[i, j]:.1f}"
            text += f" ✕{crashes}" if crashes else ""
            weight = "bold" if crashes else "normal"
            axes.text(j, i, text, ha="center", va="center", fontsize=7, fontweight=weight)
    axes.set_xticks(range(len(names)), names, rotation=35, ha="left", fontsize=8)
    axes.set_yticks(range(len(scenarios)), scenarios, fontsize=8)
    axes.tick_params(top=True, labeltop=True, bottom=False, labelbottom=False, length=0)
    axes.spines[:].set_visible(False)
    bar = figure.colorbar(picture, label="error of roll and pitch [°]", fraction=0.02, pad=0.01)
    bar.set_ticks([0.3, 1, 3, 10, 30], labels=["0.3", "1", "3", "10", "30"])
    bar.ax.minorticks_off()
    return figure


def standing_rows(judged: Verdict, silenced: Results) -> list[str]:
    """The table of the verdict, with error and crashes of a silenced network beside each network."""
    (silent,), rows = silenced.totals.values(), []
    for name, _, texts in judged.standings:
        text = f"{shown(silent.error_deg)}, ✕ {silent.crashes}" if name in NETWORKS else "–"
        columns = [texts[key] for key in ("crashed", "error [°]", "behind the best [°]", "tracking [°]")]
        rows.append(row(name, *columns[:2], text, *columns[2:]))
    return rows


def breaking_rows(results: Results) -> list[str]:
    """The least level of each disturbance at which an estimator crashed."""
    return [
        row(name, *(results.breaking_point(sweep, name) for sweep in SHOWN_SWEEPS))
        for name in results.estimators
    ]


def long_rows(results: Results) -> list[str]:
    """Crashes and attitude tracking over that of the truth, in the long flights; a silenced network last."""
    rows = {(cell.estimator, cell.scenario): cell for cell in results.rows}

    def entry(name: str, scenario: str) -> str:
        cell, truth = rows[name, scenario], rows[TRUTH, scenario]
        crashes = f", ✕ {cell.crashes}" if cell.crashes else ""
        if not (cell.attitude_deg and cell.position_m and truth.attitude_deg and truth.position_m):
            return f"–{crashes}"
        if name == TRUTH:
            return f"{truth.attitude_deg:.2f}°{crashes}"
        ratios = cell.attitude_deg / truth.attitude_deg, cell.position_m / truth.position_m
        return f"{ratios[0]:.2f} ({shown(cell.error_deg)}, {ratios[1]:.2f}){crashes}"

    return [
        row("*a silenced network*" if name == LEVEL else name, *(entry(name, each) for each in LONG))
        for name in results.estimators
    ]


def loop_parts() -> tuple[list[str], list[str]]:
    """Margins of the attitude loop at each delay of the estimator; and what 15 ms cost, in a sentence."""
    vehicle = load_vehicle("hummingbird")
    gains = vehicle.controller
    assert gains is not None
    found = {ms: loop_margins(vehicle, gains, estimator_delay=ms / 1e3)["attitude"] for ms in DELAYS_MS}
    rows = []
    for ms, m in found.items():
        stable = "barely" if m.phase_deg > 0 and m.gain_db > 0 else "unstable"
        affordable = "yes" if m.phase_deg >= 45 and m.gain_db >= 6 else stable
        rows.append(row(ms, f"{m.phase_deg:.0f}", f"{m.gain_db:.1f}", f"{m.delay_ms:.0f}", affordable))
    none, paid = found[0], found[15]
    freed = loop_margins(vehicle, design(vehicle, estimator_delay=0.0), estimator_delay=0.0)["attitude"]
    return rows, [
        f"15 ms cost {none.phase_deg - paid.phase_deg:.0f}° of phase margin and "
        f"{none.gain_db - paid.gain_db:.1f} dB of gain margin. "
        f"{paid.phase_deg:.0f}° and {paid.gain_db:.1f} dB are left, and a spare delay",
        f"of {paid.delay_ms:.0f} ms. A design without delay could have a crossover "
        f"{100 * (freed.crossover / paid.crossover - 1):.0f} % higher.",
    ]


def values(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    names = default_estimators()
    results = fly("suite", SUITE, names)
    silenced = fly("silenced", SUITE, [LEVEL])
    long = fly("long", SUITE, (*LONG_NAMES, LEVEL), LONG, changes={"duration_s": LONG_S})
    breaking = fly("breaking", BREAKING, names, seeds=BREAKING.seeds)
    publish(OUT / "suite", results)
    judged, (loop, price) = verdict(results), loop_parts()
    ranked = [each.estimator for each in judged.standings if each.estimator not in results.unranked]
    part.save(heat_map(results, ranked), "heat-map.png", colours=128)
    size = f"{len(results.scenarios)} scenarios × {len(names)} estimators × {SEEDS} seeds"
    return {
        "verdict": judged.headline,
        "conditions": fill(f"{conditions(results.scenarios)} {recommendation().elsewhere}", 125),
        "suite": f"{size}: {results.cost}.",
        "seeds": str(SEEDS),
        "breaking_seeds": str(BREAKING.seeds),
        "long_s": f"{LONG_S:g}",
        "standings": standing_rows(judged, silenced),
        "breaking": breaking_rows(breaking),
        "long": long_rows(long),
        "loop": loop,
        "price": price,
    }
