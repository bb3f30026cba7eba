"""Main effects of a designed benchmark as a picture: a panel for each axis."""

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from estimators.appearance import looks

from ..bench.axes import ALL, Effect

COLUMNS = 2


def axes_figure(effects: Sequence[Effect]) -> Figure:
    """Interquartile mean errors with 95 % intervals at each level; open markers: some flights crashed."""
    shown = [each for each in effects if not each.unranked and each.axis != ALL]
    axes = list(dict.fromkeys(each.axis for each in shown))
    appearance = looks(each.estimator for each in shown)
    rows = -(-len(axes) // COLUMNS)
    figure = Figure(figsize=(11.0, 3.0 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, sharey=True, squeeze=False).ravel()
    for panel, axis in zip(panels, axes, strict=False):
        levels = list(dict.fromkeys(each.level for each in shown if each.axis == axis))
        for k, (name, look) in enumerate(appearance.items()):
            own = [each for each in shown if (each.axis, each.estimator) == (axis, name)]
            place = np.arange(len(levels)) + 0.7 * ((k + 0.5) / len(appearance) - 0.5)
            for x, each in zip(place, own, strict=True):
                if each.error_deg is None:
                    continue
                if each.low is not None and each.high is not None:
                    panel.plot([x, x], [each.low, each.high], color=look.colour, linewidth=1.2)
                panel.plot(
                    x, each.error_deg, look.marker, color=look.colour, markersize=5,
                    markerfacecolor="white" if each.crashes else None,
                )  # fmt: skip
        panel.set_xticks(range(len(levels)), [fill(level, 14) for level in levels], fontsize="small")
        panel.set_title(axis, fontsize="medium", loc="left")
        panel.grid(alpha=0.3, axis="y")
        panel.set_yscale("log")
        panel.set_yticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
        panel.minorticks_off()
    for panel in panels[len(axes) :]:
        panel.set_visible(False)
    for panel in panels[::COLUMNS]:
        panel.set_ylabel("error [°]")
    for name, look in appearance.items():
        panels[0].plot([], [], look.marker, color=look.colour, label=name)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
    figure.suptitle("Interquartile mean error and 95 % interval; open markers: some flights crashed")
    return figure
