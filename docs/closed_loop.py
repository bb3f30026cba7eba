"""Fly the held-out suite, the designed axes, the suite and breaking points, for results.md.

A run that is cut short resumes, as `quadsim bench` does.
"""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from datetime import date

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from pages import ROOT, Part, Row, Values, number, table

from estimators.networks.network import silenced
from estimators.networks.weights_file import load_network, save_network
from estimators.registry import NETWORKS
from quadsim.held_out import HeldOut, load_held_out, releases
from quadsim.runs.console import progress_bar
from scenarios.bench.cell import FlightSettings
from scenarios.bench.controllers import default_estimators
from scenarios.bench.experiment import load_experiment
from scenarios.bench.recommendation import Recommendation, recommendation, save_recommendation
from scenarios.bench.results import Results
from scenarios.bench.runner import bench
from scenarios.bench.verdict import Verdict, conditions, error_text, verdict

OUT = ROOT / "reports" / "closed-loop"
AXES, BREAKING = load_experiment("axes"), load_experiment("breaking-points")
SEEDS = 20
"""Of the suite."""
SILENCED = OUT / "silenced.safetensors"
"""A network with output weights of zero."""
SWEEPS = ("constant wind", "step of the gyro bias", "lost samples")
BEHIND, TRACKING = "error minus that of rank 1 [°]", "attitude tracking [°]"


def fly_experiment(
    folder: str,
    names: Sequence[str],
    experiment: str = "suite",
    scenarios: Sequence[str] | None = None,
    seeds: int | None = None,
    changes: Mapping[str, object] | None = None,
) -> Results:
    """An experiment in a folder of its own."""
    loaded = load_experiment(experiment)
    settings = FlightSettings(seeds or loaded.seeds, loaded.seed or 0)
    with progress_bar(folder, "cells") as bar:
        return bench(scenarios, names, OUT / folder, settings, changes or {}, experiment=loaded, progress=bar)


def beside_crashes(value: float | None, crashes: float) -> str:
    """A number, a dash where all flights crashed, and the number of crashed flights if there are any."""
    return number(np.nan if value is None else value) + (f" ✕{crashes:.0f}" if crashes else "")


def standings(judged: Verdict) -> pd.DataFrame:
    """The table of a verdict."""
    return pd.DataFrame({"estimator": each.estimator, **each.texts} for each in judged.standings)


# --- the held-out suite and the axes --------------------------------------------------------------


def by_level(results: Results, axis: str) -> pd.DataFrame:
    """A table of one axis: estimators against levels."""

    def cell(name: str, level: str) -> str:
        each = results.by_level[axis, level, name]
        return beside_crashes(each.error_deg, each.crashes) if each.flights else "does not fly"

    return pd.DataFrame(
        {axis: name, **{level: cell(name, level) for level in results.axes[axis]}}
        for name in results.estimators
        if name not in results.unranked
    )


def ranges(held_out: HeldOut) -> list[Row]:
    """What the held-out suite is drawn from."""
    said = {
        "kind of flight": "hover, a figure of eight, random manoeuvres",
        "mean wind, from any side": "{}–{} m/s".format(*held_out.wind),
        "Dryden turbulence, in half of the scenarios": "wind at a height of 20 ft: {}–{} m/s".format(
            *held_out.wind_20ft
        ),
        "duration of a lap of the figure of eight": "{}–{} s".format(*held_out.period_s),
        "largest tilt in random manoeuvres": "{}–{}°".format(*held_out.tilt_deg),
    }
    levels = {axis: ", ".join(of) for axis, of in AXES.axes.items()}
    return list((said | levels).items())


def held_out(part: Part, given: Namespace) -> Values:
    """Fly the held-out suite, whose recommendation is saved, and the axes."""
    drawn = load_held_out(releases()[-1])
    unseen = verdict(fly_experiment("held-out", default_estimators(), "held-out"))
    command, today = "quadsim bench --experiment held-out", date.today().isoformat()
    save_recommendation(
        Recommendation(release=drawn.release, command=command, date=today, sentence=unseen.headline)
    )
    looked_at = fly_experiment("axes", default_estimators(), "axes")
    judged = verdict(looked_at)  # which repeats the recommendation
    return {
        "release": drawn.release,
        "seed": str(drawn.seed),
        "scenarios": str(drawn.scenarios),
        "flights": str(drawn.flights),
        "ranges": ranges(drawn),
        "recommendation": unseen.headline,
        "advice": [f"- {line}" for line in unseen.lines],
        "standings": standings(unseen),
        "cells": str(AXES.combinations),
        "cell_flights": str(AXES.seeds),
        "flown_in": ", ".join(f"`{name}`" for name in AXES.scenarios),
        "axes_advice": [f"- {line}" for line in judged.lines],
        "axes_standings": standings(judged),
        "levels": [f"{table(by_level(looked_at, axis))}\n" for axis in [*AXES.axes, "scenario"]],
    }


# --- the suite ------------------------------------------------------------------------------------


def heat_map(results: Results, names: Sequence[str]) -> Figure:
    """Mean error of every estimator in every scenario, best estimators first; crashes in bold."""
    scenarios = list(results.scenarios)
    rows = {(each.scenario, each.estimator): each for each in results.rows}
    error = np.array([[rows[s, e].error_deg or np.nan for e in names] for s in scenarios], dtype=float)
    figure = Figure(figsize=(9.6, 0.27 * len(scenarios) + 1.6), layout="constrained")
    axes = figure.subplots()
    axes.grid(visible=False)
    colours = matplotlib.colormaps["YlOrRd"].copy()
    colours.set_bad("#f2f2f2")
    picture = axes.imshow(error, norm=LogNorm(0.3, 30.0), cmap=colours, aspect="auto", alpha=0.8)
    for i, scenario in enumerate(scenarios):
        for j, name in enumerate(names):
            crashes = rows[scenario, name].crashes
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


def suite_standings(judged: Verdict, silent: Results) -> pd.DataFrame:
    """The table of the verdict, with error and crashes of a silenced network beside each network."""
    (level,) = silent.totals.values()
    found = standings(judged)
    text = f"{error_text(level.error_deg)}, ✕ {level.crashes}"
    found["silenced network [°]"] = np.where(found["estimator"].isin(NETWORKS), text, "–")
    return found[["estimator", "crashed", "error [°]", "silenced network [°]", BEHIND, TRACKING]]


def suite(part: Part, given: Namespace) -> Values:
    """Fly the suite and breaking points, and draw errors by scenario."""
    OUT.mkdir(parents=True, exist_ok=True)
    config, tensors = load_network("att-snn-paper")
    save_network(SILENCED, config, silenced(config, tensors))
    names = default_estimators()
    results = fly_experiment("suite", names, seeds=SEEDS)
    silent = fly_experiment("silenced", [str(SILENCED)], seeds=SEEDS)
    breaking = fly_experiment("breaking", names, "breaking-points")
    judged = verdict(results)
    ranked = [each.estimator for each in judged.standings if each.estimator not in results.unranked]
    part.save(heat_map(results, ranked), "heat-map.png", colours=128)
    size = f"{len(names)} estimators flew {len(results.scenarios)} scenarios with {SEEDS} seeds each"
    return {
        "verdict": judged.headline,
        "conditions": f"{conditions(results.scenarios)} {recommendation().elsewhere}",
        "suite": f"{size} ({results.cost}).",
        "seeds": str(SEEDS),
        "breaking_seeds": str(BREAKING.seeds),
        "standings": suite_standings(judged, silent),
        "breaking": [(name, *(breaking.breaking_point(sweep, name) for sweep in SWEEPS)) for name in names],
    }
