"""The leaderboard of task entries: one self-contained HTML page."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from estimators.appearance import looks
from estimators.metrics import Summary
from quadsim.runs.files import write_whole

from ..bench.ranking import ranked
from ..bench.results import wilson
from ..task.entry import FILE, Entry, load_entry
from .page import script
from .template import render

ERROR = "error_deg"
TITLES = {"home": "quadsim", "rotorpy": "RotorPy", "broad": "BROAD, real"}
"""Headings of parts whose name is not suitable."""
FOOTER = (
    "Entries are ranked by the number of flights without a crash, then by the time to the crash, then by "
    "the error on the flights that all entries with as many survived flights completed. 'Better than the "
    "leader' is the share of flights, averaged over scenarios, in which the error is smaller than the "
    "leader's on the same flight; a crash is worse than any error, and equal flights count half. All "
    "intervals are 95 % intervals: Wilson's for crashes, the bootstrap's over scenarios, flights or trials "
    "elsewhere."
)


class TableCell(NamedTuple):
    """A cell of the table."""

    text: str
    value: float | None  #: by which it is sorted
    title: str = ""


NONE = TableCell("–", None)


def find_entries(folders: Sequence[Path]) -> list[Entry]:
    """Find entries in folders and their subfolders.

    Of several with the same task, code and name, the last is used.

    Raises:
        ValueError: There is no entry, or a file is not an entry.
    """
    files = [
        file
        for folder in folders
        for file in sorted([*folder.expanduser().glob(FILE), *folder.expanduser().glob(f"*/{FILE}")])
    ]
    found = {
        (entry.version, entry.task, entry.code, entry.card.name): entry for entry in map(load_entry, files)
    }
    if not found:
        raise ValueError(f"{', '.join(map(str, folders))}: no {FILE}; quadsim bench --task writes them")
    return [found[key] for key in sorted(found)]


def write_leaderboard(path: Path, entries: Sequence[Entry]) -> Path:
    """Write the page; entries of another task or other code have a separate table."""
    boards = [
        _board(title, list(own))
        for title, own in groupby(
            entries, lambda each: f"{each.version} (task {each.task[:8]}, code {each.code[:8]})"
        )
    ]
    page = render(
        "report/leaderboard.html",
        title="Leaderboard",
        kicker="attitude estimation",
        boards=boards,
        footer=FOOTER,
        script=script("report/js/leaderboard.js"),
    )
    return write_whole(path.expanduser(), page)


def _board(title: str, entries: Sequence[Entry]) -> dict[str, Any]:
    """The tables of all tracks, and pictures of the entries that are ranked."""
    flights = closed_loop_flights(entries)
    names = [each.card.name for each in entries if not each.reasons]
    pictures = {"Performance profile": profile(flights, names), "Error and cost": fronts(entries)}
    return {
        "title": title,
        "tracks": [_track(each, entries, flights) for each in sorted({each.card.track for each in entries})],
        "pictures": {name: _encoded(figure) for name, figure in pictures.items() if names},
    }


def closed_loop_flights(entries: Sequence[Entry]) -> pd.DataFrame:
    """Return the closed-loop flights of entries, one row per flight."""
    rows = [{"estimator": each.card.name, **asdict(flight)} for each in entries for flight in each.flights]
    columns = ["estimator", "scenario", "seed", "cause", "flown_s", ERROR]
    return pd.DataFrame(rows, columns=columns).astype({ERROR: float})


def standing(entries: Sequence[Entry], flights: pd.DataFrame) -> list[str]:
    """Return the names of ranked entries, the best first."""
    names = [each.card.name for each in entries if not each.reasons and each.flights]
    planned = list(dict.fromkeys(zip(flights["scenario"], flights["seed"], strict=True)))
    own: Any = flights[flights["estimator"].isin(names)]
    return [place.name for place in ranked(own, planned, ERROR)]


def improvement(flights: pd.DataFrame, name: str, leader: str) -> Summary:
    """Return the share of flights in which an entry is better than another, for each scenario.

    This is the probability of improvement of Agarwal et al. (NeurIPS 2021) on paired flights.
    """
    score = flights.assign(score=flights[ERROR].where(flights["cause"] == "", np.inf).fillna(np.inf))
    wide: Any = score.pivot(index=["scenario", "seed"], columns="estimator", values="score").fillna(np.inf)
    wins = (wide[name] < wide[leader]) + 0.5 * (wide[name] == wide[leader])
    return Summary(wins.groupby(level=0).mean().to_numpy())


def _track(track: str, entries: Sequence[Entry], flights: pd.DataFrame) -> dict[str, Any]:
    """The table of a track: ranked entries, the best first, then the others."""
    own = {each.card.name: each for each in entries if each.card.track == track}
    order = standing(list(own.values()), flights)
    rows = []
    for name in [*order, *(name for name in own if name not in order)]:
        entry, better, leads = own[name], NONE, order[:1] == [name]
        if name in order and not leads:
            wins = improvement(flights, name, order[0])
            low, high = wins.mean_interval()
            better = TableCell(f"{100 * wins.mean:.0f} % ({100 * low:.0f}–{100 * high:.0f})", wins.mean)
        rank = order.index(name) + 1 if name in order else None
        cells = {
            "rank": TableCell(str(rank), float(rank)) if rank else NONE,
            "crashed": _crash_cell(entry),
            "error in closed loop [°]": _mean_cell(loop_errors(entry)),
            "better than the leader": better,
        }
        cells |= {f"{TITLES.get(k, k)} [°]": _mean_cell(p.errors, p.note) for k, p in entry.parts.items()}
        why = f"not ranked: it {entry.reasons[0]}" if entry.reasons else ""
        rows.append({"entry": entry, "cells": cells | _cost_cells(entry), "why": why})
    headings = list(dict.fromkeys(heading for row in rows for heading in row["cells"]))
    return {"name": track, "rows": rows, "headings": headings}


def _crash_cell(entry: Entry) -> TableCell:
    flown, crashes = len(entry.flights), sum(flight.cause != "" for flight in entry.flights)
    if not flown:
        return NONE
    low, high = wilson(crashes, flown)
    return TableCell(f"{crashes} of {flown} ({100 * low:.1f}–{100 * high:.1f}\u00a0%)", crashes / flown)


def loop_errors(entry: Entry) -> Summary | None:
    """Return the mean error of each scenario over flights without a crash [°].

    The error is None if all flights crashed.
    """
    survived: Any = closed_loop_flights([entry]).query("cause == ''").groupby("scenario", sort=False)
    means = survived[ERROR].mean().dropna().to_numpy()
    return Summary(means) if means.size else None


def _mean_cell(errors: Summary | None, title: str = "") -> TableCell:
    if errors is None:
        return TableCell("–", None, title)
    low, high = errors.mean_interval()
    return TableCell(f"{errors.mean:.2f} ({low:.2f}–{high:.2f})", errors.mean, title)


def _cost_cells(entry: Entry) -> dict[str, TableCell]:
    cost = entry.cost
    if cost is None:
        return {}
    found = {
        "time [µs]": TableCell(f"{cost.ns / 1e3:.1f}", cost.ns),
        "memory [kB]": TableCell(f"{cost.footprint / 1e3:.1f}", cost.footprint),
        "parameters": TableCell(str(entry.card.parameter_count), entry.card.parameter_count),
    }
    for heading, value in {"operations": cost.operations, "energy [nJ]": cost.nanojoules}.items():
        text = "–" if value is None else f"{value:.3g}" if value < 1000 else f"{value:.0f}"
        found[heading] = TableCell(text, value, cost.model)
    return found


# --- pictures -------------------------------------------------------------------------------------


def profile(flights: pd.DataFrame, names: Sequence[str]) -> Figure:
    """Return the share of flights with an error below each limit; a crash is above all limits."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes = figure.subplots()
    for name, look in looks(names).items():
        own = flights.query("estimator == @name")
        errors = np.sort(own.query("cause == ''")[ERROR].to_numpy())
        share = np.arange(1, len(errors) + 1) / max(len(own), 1)
        axes.step(
            errors, share, where="post", label=name, color=look.colour, linestyle=look.points["linestyle"]
        )
    axes.set(xscale="log", xlabel="error [°]", ylabel="share of the flights below", ylim=(0.0, 1.0))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def fronts(entries: Sequence[Entry]) -> Figure:
    """Draw the error in closed loop over modelled energy and over time; the line joins the Pareto front."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    errors = {each.card.name: loop_errors(each) for each in entries if not each.reasons}
    shown = [
        (each.cost, own.mean, each.card.name)
        for each in entries
        if each.cost and (own := errors.get(each.card.name))
    ]
    drawn = looks([name for _, _, name in shown])
    panels: Mapping[str, Any] = {
        "modelled energy per sample [nJ]": lambda cost: cost.nanojoules,
        "time per sample in Python [µs]": lambda cost: cost.ns / 1e3,
    }
    points_of = {}
    for axes, (label, of) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        found = [(of(cost), error, name) for cost, error, name in shown]
        points: list[Any] = sorted(point for point in found if None not in point)
        for cost, error, name in points:
            (points_of[name],) = axes.plot(cost, error, drawn[name].marker, color=drawn[name].colour)
        best = np.minimum.accumulate([error for _, error, _ in points]) if points else np.empty(0)
        front = [(c, e) for (c, e, _), least in zip(points, best, strict=True) if e == least]
        axes.plot([c for c, _ in front], [e for _, e in front], color="0.5", linewidth=0.8)
        axes.set(xscale="log", xlabel=label, ylabel="error in closed loop [°]")
        axes.grid(alpha=0.3)
    figure.legend([*points_of.values()], [*points_of], loc="outside right upper", fontsize=8)
    return figure


def _encoded(figure: Figure) -> str:
    content = BytesIO()
    figure.savefig(content, format="png", dpi=130)
    return base64.b64encode(content.getvalue()).decode()
