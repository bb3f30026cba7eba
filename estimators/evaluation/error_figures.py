"""Figures of the offline comparison. Each function returns a matplotlib figure."""

from collections.abc import Iterable

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from ..appearance import looks
from .comparison import BLOCK_S, SETTLED_DEG, TILTS_DEG, Evaluation

Array = NDArray[np.float64]
COLOURS = {"unknown": "#c0563b", "known": "#33658a"}
PLAIN = FuncFormatter(lambda value, _: f"{value:g}")
PLAIN_FEW = FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "235" else "")
PANELS = 4
"""Number of panels in a row."""


def violins(evaluation: Evaluation) -> Figure:
    """Draw the distribution of the mean absolute error over sequences, one violin per estimator and start."""
    names = _shown(evaluation, (name for name, _ in evaluation.sequences))
    starts = list(dict.fromkeys(row.initial for row in evaluation.rows))
    figure = Figure(figsize=(1.5 + 0.9 * len(names), 4.2), layout="constrained")
    axes = figure.subplots()
    width = 0.8 / len(starts)
    for k, start in enumerate(starts):
        there = [place for place, name in enumerate(names) if (name, start) in evaluation.sequences]
        places = np.array(there) + (k - 0.5 * (len(starts) - 1)) * width
        if not there:
            continue
        data = [evaluation.sequences[names[place], start] for place in there]
        parts = axes.violinplot(data, positions=places, widths=0.9 * width, showmedians=True)
        for body in parts["bodies"]:  # type: ignore[union-attr]  # matplotlib's stub names one collection
            body.set(facecolor=COLOURS[start], alpha=0.5)
        for part in ("cmedians", "cmins", "cmaxes", "cbars"):
            parts[part].set(color=COLOURS[start], linewidth=1.0)
        axes.plot([], [], color=COLOURS[start], linewidth=6.0, alpha=0.5, label=f"{start} start")
    axes.set_xticks(np.arange(len(names)), names, rotation=35, ha="right")
    axes.set(ylabel="mean absolute error of roll and pitch [°]", yscale="log")
    axes.yaxis.set_major_formatter(PLAIN)
    axes.yaxis.set_minor_formatter(PLAIN_FEW)
    axes.grid(axis="y", which="both", alpha=0.3)
    axes.legend(frameon=False)
    return figure


def settling(evaluation: Evaluation) -> Figure:
    """Draw the recovery after a start at an unknown tilt: the median inclination error over time.

    Each estimator has a panel with a line per tilt; the lines of all other estimators are grey.
    """
    names = _shown(evaluation, (name for name, _ in evaluation.settling))
    columns = min(max(len(names), 1), PANELS)
    rows = max(-(-len(names) // columns), 1)
    figure = Figure(figsize=(8.0, 1.0 + 1.6 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for (name, look), axes in zip(looks(names).items(), panels.flat, strict=False):
        for curve in evaluation.settling.values():
            axes.plot(_blocks(curve), curve, color="#d8d8d8", lw=0.6)
        for tilt, dash in zip(TILTS_DEG, ("-", "--"), strict=True):
            if tilt not in evaluation.tilts_deg:
                continue
            curve = evaluation.settling[name, tilt]
            axes.plot(_blocks(curve), curve, color=look.colour, ls=dash, lw=1.6, label=f"from {tilt:.0f}°")
        axes.axhline(SETTLED_DEG, color="black", linewidth=0.8, linestyle=":")
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(PLAIN)
        axes.set_title(name, fontsize=8.5, fontweight="bold", loc="left", color=look.colour)
        axes.grid(alpha=0.3)
        axes.label_outer()
    for axes in panels.flat[len(names) :]:
        axes.set_axis_off()
    for axes in panels.flat[max(len(names) - columns, 0) : len(names)]:
        axes.xaxis.set_tick_params(labelbottom=True)
    if names:
        panels.flat[0].legend(
            frameon=False, fontsize=8, handlelength=1.8, loc="upper right", borderaxespad=0.0
        )
    figure.supxlabel("time [s]", fontsize=10)
    figure.supylabel("inclination error [°]", fontsize=10)
    return figure


def _blocks(curve: Array) -> Array:
    """Return the centre times of the blocks of a curve [s]."""
    return BLOCK_S * np.arange(0.5, curve.size)


def _shown(evaluation: Evaluation, names: Iterable[str]) -> list[str]:
    """Return each name once, without references, whose zero error cannot be drawn on a logarithmic axis."""
    references = set(evaluation.table.estimator[evaluation.table.reference])
    return [name for name in dict.fromkeys(names) if name not in references]
