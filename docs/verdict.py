"""Fly the held-out suite and the designed axes, and write verdict.md: `python docs/pages.py verdict`.

A run that is cut short resumes, as `quadsim bench` does.
"""

from argparse import Namespace
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import matplotlib
from pages import Page, Parts, row

import estimators
from quadsim.dataset.figures import STYLE
from quadsim.flight.scenario import Scenario
from quadsim.held_out import HeldOut, load_held_out, releases
from quadsim.runs.console import progress_bar
from scenarios.bench.axes import (
    ALL,
    AXES,
    SCENARIOS,
    Combination,
    Effect,
    advice,
    choices,
    design,
    effects,
    headline,
    ranking,
    scenario_of,
    worst_level,
)
from scenarios.bench.held_out import suite
from scenarios.bench.recommendation import Recommendation, save_recommendation
from scenarios.bench.runner import Results, bench, identical
from scenarios.bench.settings import FlightSettings
from scenarios.demo import SLOW
from scenarios.report.axes_figure import axes_figure

OUT = Path(__file__).parents[1] / "reports" / "verdict"
FLIGHTS = 4
"""Of each estimator in each combination of the design."""


def fly(name: str, scenarios: dict[str, Scenario], seeds: int, seed: int) -> Results:
    """A benchmark of all estimators in a folder of its own."""
    names = [each for each in estimators.names() if each not in SLOW]
    with progress_bar(name, "cells") as progress:
        return bench(scenarios, names, OUT / name, FlightSettings(seeds, seed), progress=progress)


def standing_rows(found: Sequence[Effect]) -> list[str]:
    """Estimators over all flights, from best to worst."""
    whole = {e.estimator: e for e in found if e.axis == ALL}
    rows = []
    for name in ranking(found):
        each, worst = whole[name], worst_level(found, name)
        assert worst is not None
        low, high = 100 * each.crash_low, 100 * each.crash_high
        rows.append(
            row(
                each.estimator,
                f"{each.crashes} of {each.flights}",
                f"{low:.0f}–{high:.0f} %",
                _error(each),
                each.failed or "–",
                f"{worst.axis}: {worst.level}",
                f"{worst.crashes} of {worst.flights}, {_error(worst)}",
            )
        )
    return rows


def _error(each: Effect) -> str:
    if each.error_deg is None:
        return "–"
    return f"{each.error_deg:.2f}" + ("" if each.low is None else f" ({each.low:.2f}–{each.high:.2f})")


def level_rows(found: Sequence[Effect], axis: str) -> list[str]:
    """A table of one axis, with its heading: estimators against levels."""
    levels = list(dict.fromkeys(e.level for e in found if e.axis == axis))
    of = {(e.estimator, e.level): e for e in found if e.axis == axis}
    names = list(dict.fromkeys(e.estimator for e in found if e.axis == axis and not e.unranked))
    lines = [row(axis, *levels), "|---" * (len(levels) + 1) + "|"]
    for name in names:
        cells = []
        for level in levels:
            each = of[name, level]
            crashed = f" ✕{each.crashes}" if each.crashes else ""
            error = "–" if each.error_deg is None else f"{each.error_deg:.2f}"
            cells.append(f"{error}{crashed}" if each.flights else "does not fly")
        lines.append(row(name, *cells))
    return [*lines, ""]


def ranges(held_out: HeldOut) -> list[str]:
    """What the held-out suite is drawn from."""
    said = {
        "kind of flight": "hover, a figure of eight, random manoeuvres",
        "mean wind, from any side": "{}–{} m/s".format(*held_out.wind),
        "Dryden turbulence, in half of them": "wind at 20 ft of {}–{} m/s".format(*held_out.wind_20ft),
        "lap of the figure of eight": "{}–{} s".format(*held_out.period_s),
        "largest tilt of random manoeuvres": "{}–{}°".format(*held_out.tilt_deg),
    }
    return [
        row(*each) for each in (said | {axis: ", ".join(levels) for axis, levels in AXES.items()}).items()
    ]


def lines_of(combinations: Sequence[Combination], results: Results) -> list[str]:
    """The advice as a list."""
    return [f"- {line}" for line in advice(combinations, results)]


def values(page: Page, given: Namespace) -> Parts:
    """Measure everything, and draw."""
    held_out = load_held_out(releases()[-1])
    drawn = suite(held_out)
    unseen = fly("held-out", {k: s for k, (_, s) in drawn.items()}, held_out.flights, held_out.seed)
    new = [combination for combination, _ in drawn.values()]
    combinations = design()
    looked_at = fly("axes", {each.name: scenario_of(each) for each in combinations}, FLIGHTS, 0)
    found = effects(combinations, looked_at)
    sentence = headline(choices(new, unseen), new)
    command, today = "quadsim bench --held-out", date.today().isoformat()
    save_recommendation(
        Recommendation(release=held_out.release, command=command, date=today, sentence=sentence)
    )
    with matplotlib.rc_context(STYLE):
        page.save(axes_figure(found), "verdict-axes.png", dpi=110, colours=128)
    same = ", ".join(f"`{name}` flew exactly as `{other}`" for name, other in identical(unseen).items())
    return {
        "release": held_out.release,
        "seed": str(held_out.seed),
        "scenarios": str(held_out.scenarios),
        "flights": str(held_out.flights),
        "ranges": ranges(held_out),
        "recommendation": sentence,
        "advice": lines_of(new, unseen),
        "standings": standing_rows(effects(new, unseen)),
        "same": f"{same}; it is shown once." if same else "",
        "cells": str(len(combinations)),
        "cell_flights": str(FLIGHTS),
        "flown_in": ", ".join(f"`{name}`" for name in SCENARIOS),
        "axes_advice": lines_of(combinations, looked_at),
        "axes_standings": standing_rows(found),
        "levels": [line for axis in [*AXES, "scenario"] for line in level_rows(found, axis)],
    }
