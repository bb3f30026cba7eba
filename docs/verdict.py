"""Fly the held-out suite and the designed axes, for results.md: `python docs/pages.py verdict`.

A run that is cut short resumes, as `quadsim bench` does.
"""

from argparse import Namespace
from datetime import date
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure
from pages import Part, Values, row

from estimators.appearance import looks
from quadsim.held_out import HeldOut, load_held_out, releases
from quadsim.runs.console import progress_bar
from scenarios.bench.cell import FlightSettings
from scenarios.bench.controllers import default_estimators
from scenarios.bench.experiment import load_experiment
from scenarios.bench.recommendation import Recommendation, save_recommendation
from scenarios.bench.results import Results
from scenarios.bench.runner import bench
from scenarios.bench.verdict import Verdict, verdict

OUT = Path(__file__).parents[1] / "reports" / "verdict"
HELD_OUT, AXES = load_experiment("held-out"), load_experiment("axes")


def fly(name: str) -> Results:
    """An experiment of all estimators in a folder of its own."""
    experiment = load_experiment(name)
    settings = FlightSettings(experiment.seeds, experiment.seed or 0)
    with progress_bar(name, "cells") as bar:
        return bench(
            None, default_estimators(), OUT / name, settings, experiment=experiment, progress=bar
        )  # fmt: skip


def standing_rows(judged: Verdict) -> list[str]:
    """The table of a verdict, with its heading."""
    headings = ["estimator", *judged.standings[0].texts]
    rows = [row(each.estimator, *each.texts.values()) for each in judged.standings]
    return [row(*headings), "|---" * len(headings) + "|", *rows]


def level_rows(results: Results, axis: str) -> list[str]:
    """A table of one axis, with its heading: estimators against levels."""
    levels = results.axes[axis]
    lines = [row(axis, *levels), "|---" * (len(levels) + 1) + "|"]
    for name in (each for each in results.estimators if each not in results.unranked):
        cells = []
        for level in levels:
            each = results.by_level[axis, level, name]
            error = "–" if each.error_deg is None else f"{each.error_deg:.2f}"
            cells.append(error + f" ✕{each.crashes}" * bool(each.crashes) if each.flights else "does not fly")
        lines.append(row(name, *cells))
    return [*lines, ""]


def draw_levels(results: Results) -> Figure:
    """Mean errors at each level of each axis; open markers: some flights crashed."""
    appearance = looks(name for name in results.estimators if name not in results.unranked)
    figure = Figure(figsize=(11.0, 9.6), layout="constrained")
    panels = figure.subplots(3, 2, sharey=True).ravel()
    for panel, (axis, levels) in zip(panels, results.axes.items(), strict=True):
        for k, (name, look) in enumerate(appearance.items()):
            shift = 0.7 * ((k + 0.5) / len(appearance) - 0.5)
            for x, level in enumerate(levels):
                each = results.by_level[axis, level, name]
                face = "white" if each.crashes else look.colour
                panel.plot(
                    x + shift, each.error_deg or np.nan, look.marker, color=look.colour, markersize=5,
                    markerfacecolor=face, label=name if (panel is panels[0] and x == 0) else None,
                )  # fmt: skip
        panel.set_xticks(range(len(levels)), [fill(level, 14) for level in levels], fontsize="small")
        panel.set_title(axis, fontsize="medium", loc="left")
        panel.set_yscale("log")
        panel.set_yticks([1, 2, 5, 10], ["1", "2", "5", "10"])
        panel.minorticks_off()
    figure.supylabel("error [°]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    figure.suptitle("Mean error of flights without a crash; open markers: some flights crashed")
    return figure


def ranges(held_out: HeldOut) -> list[str]:
    """What the held-out suite is drawn from."""
    said = {
        "kind of flight": "hover, a figure of eight, random manoeuvres",
        "mean wind, from any side": "{}–{} m/s".format(*held_out.wind),
        "Dryden turbulence, in half of them": "wind at 20 ft of {}–{} m/s".format(*held_out.wind_20ft),
        "lap of the figure of eight": "{}–{} s".format(*held_out.period_s),
        "largest tilt of random manoeuvres": "{}–{}°".format(*held_out.tilt_deg),
    }
    levels = {axis: ", ".join(of) for axis, of in AXES.axes.items()}
    return [row(*each) for each in (said | levels).items()]


def values(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    held_out = load_held_out(releases()[-1])
    unseen = verdict(fly("held-out"))
    command, today = "quadsim bench --experiment held-out", date.today().isoformat()
    save_recommendation(
        Recommendation(release=held_out.release, command=command, date=today, sentence=unseen.headline)
    )
    looked_at = fly("axes")
    judged = verdict(looked_at)  # which repeats the recommendation
    part.save(draw_levels(looked_at), "verdict-axes.png", dpi=110, colours=128)
    return {
        "release": held_out.release,
        "seed": str(held_out.seed),
        "scenarios": str(held_out.scenarios),
        "flights": str(held_out.flights),
        "ranges": ranges(held_out),
        "recommendation": unseen.headline,
        "advice": [f"- {line}" for line in unseen.lines],
        "standings": standing_rows(unseen),
        "cells": str(AXES.combinations),
        "cell_flights": str(AXES.seeds),
        "flown_in": ", ".join(f"`{name}`" for name in AXES.scenarios),
        "axes_advice": [f"- {line}" for line in judged.lines],
        "axes_standings": standing_rows(judged),
        "levels": [line for axis in [*AXES.axes, "scenario"] for line in level_rows(looked_at, axis)],
    }
