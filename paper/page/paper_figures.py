"""Figures in the form of the paper's, from the numbers of the stages.

Lines and markers are distinct in grey.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from estimators.appearance import look

from ..plan import SNN
from ..work.scores import CONVERGED_DEG, FILTERS, RESPONSE_S, SHOWN_HZ, SIX
from .claims import METHODS, NETWORKS, QUOTED, Numbers, errors
from .tables import CURVES, OWN, RESPONSES

BLACK, GREY, LIGHT = "#111111", "#999999", "#d9d9d9"
COLOURS = (BLACK, "#0072b2", "#e08a00", "#7a5195", "#6b6b6b")
DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1)))
DIAMOND: dict[str, Any] = {"marker": "D", "ls": "", "mfc": "white", "color": BLACK, "ms": 5}
"""Style of the paper's values."""
SAME = {"att-snn, chip": "att-snn-loihi"}
"""Networks of the paper, and the estimators whose styles they have."""


def _panels(width: float, height: float, *shape: int, **options: Any) -> tuple[Figure, Any]:
    """A figure of a size [inch] and its axes."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(*shape, **options)


def _note(axes: Axes, text: str, at: tuple[float, float], shift: tuple[float, float], **options: Any) -> None:
    """Write small text beside a point, shifted by so many points."""
    style: dict[str, Any] = {"fontsize": 7} | options
    axes.annotate(text, at, shift, textcoords="offset points", **style)


def _name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Name horizontal bars, the first on top."""
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)


def fig4(numbers: Numbers) -> Figure:
    """Draw training and validation loss of the networks over epochs."""
    figure, panels = _panels(10.2, 3.0, 1, len(CURVES), sharey=True)
    for axes, (stage, title) in zip(panels, CURVES.items(), strict=True):
        for kind, label, style in (
            ("train_mse", "training", {"color": GREY, "ls": "--"}),
            ("val_mse", "validation", {"color": BLACK, "ls": "-"}),
        ):
            loss = numbers[stage][kind]
            axes.plot(np.arange(1, len(loss) + 1), loss, label=label, lw=1.0, **style)
        best = numbers[stage]["best"]
        axes.plot(best["epoch"] + 1, best["val_mse"], "o", ms=5, mfc="none", color=BLACK, label="best")
        axes.set_title(title.replace(" (", "\n("))
        axes.set(xlabel="epoch", yscale="log")
    panels[0].set_ylabel("mean square error [rad²]")
    panels[0].legend(fontsize=8)
    return figure


def fig5(numbers: Numbers) -> Figure:
    """Draw the errors of the second domain's test flights, with an unknown and a known start."""
    names = [*SIX, *OWN]
    figure, axes = _panels(9.6, 3.8)
    handles: list[Artist] = []
    for shift, start, hatch, colour in ((-0.2, "unknown", "////", LIGHT), (0.2, "known", "", "#8f8f8f")):
        shown = [name for name in names if start == "unknown" or not name.startswith("att")]
        positions = [names.index(name) + shift for name in shown]
        data = [errors(numbers, name, start) for name in shown]
        parts = axes.violinplot(data, positions=positions, widths=0.36, showmedians=True)
        for body in parts["bodies"]:
            body.set(facecolor=colour, edgecolor=BLACK, alpha=1.0, hatch=hatch, linewidth=0.7)
        for part in ("cmedians", "cmins", "cmaxes", "cbars"):
            parts[part].set(color=BLACK, linewidth=1.0)
        quoted = [
            (names.index(name) + shift, each[1][1]) for (name, s), each in METHODS.items() if s == start
        ]
        label = "the paper, mean on its flights" if start == "known" else None
        drawn = axes.plot(*zip(*quoted, strict=True), **DIAMOND, zorder=5, label=label)
        handles.append(Patch(facecolor=colour, edgecolor=BLACK, hatch=hatch, label=f"{start} start"))
    titles = [OWN.get(name, name).replace(" (", "\n(") for name in names]
    axes.set_xticks(range(len(names)), titles, fontsize=8)
    axes.set(ylabel="mean absolute error of a flight [°]")
    axes.set_ylim(bottom=0)
    axes.grid(axis="x", visible=False)
    axes.legend(handles=[*handles, *drawn], fontsize=8)
    return figure


def fig6(numbers: Numbers) -> Figure:
    """Draw pitch after a start with an error of 20°, and the median inclination error after all of them."""
    found = numbers["recover"]
    figure, panels = _panels(10.2, 3.8, 1, 3)
    one, *medians = panels
    truth = found["example"]["truth"]
    one.plot(np.arange(len(truth)) / SHOWN_HZ, truth, color=BLACK, lw=2.5, alpha=0.5, label="truth")
    for k, name in enumerate((*FILTERS, *NETWORKS)):
        style = {"ms": 4, "lw": 2.0 if name == "att-snn" else 1.0, "markevery": (5 * k, 40)} | look(
            SAME.get(name, name)
        ).points
        pitch = found["example"][name]
        one.plot(np.arange(len(pitch)) / SHOWN_HZ, pitch, label=name, **style)
        for axes, kind in zip(medians, ("flight", "hover"), strict=True):
            if kind in found["curves"][name]:
                error = found["curves"][name][kind]["median"]
                axes.plot(np.arange(len(error)) / SHOWN_HZ, error, label=name, **style)
    one.set(title="one start, in flight", xlabel="time [s]", ylabel="pitch [°]", xlim=(0, RESPONSE_S))
    for axes, title in zip(medians, ("all starts, in flight", "in hover, given a roll of 20°"), strict=True):
        axes.axhline(CONVERGED_DEG, color=BLACK, lw=0.8, ls=":")
        for (key, seconds), sign in zip(QUOTED["converge_s"].items(), "<>", strict=True):
            axes.axvline(seconds, color=GREY, lw=0.8)
            _note(axes, f"the paper:\n{key} {sign} {seconds:g} s", (seconds, 25), (3, 0), color="#555555")
        axes.set(title=title, xlabel="time [s]", xlim=(0, RESPONSE_S), ylim=(0, 30))
    medians[0].set_ylabel("inclination error, median [°]")
    figure.legend(*one.get_legend_handles_labels(), fontsize=8, ncols=8, loc="outside lower center")
    return figure


def fig7(numbers: Numbers) -> Figure:
    """Draw the spike rates of the neurons, the most active first, and the error without some of them."""
    inside = numbers["inside"]
    figure, (left, right) = _panels(9.6, 3.2, 1, 2)
    for k, layer in enumerate(("encoding", "recurrent")):
        rates = np.maximum(np.sort(inside["rates"][k])[::-1], 1e-5)
        share = 100 * np.arange(1, len(rates) + 1) / len(rates)
        left.step(share, rates, color=COLOURS[k], ls=DASHES[k], label=layer)
    left.axhline(0.005, color=GREY, lw=0.8)
    _note(left, "0.5 % of the steps", (0, 0.005), (2, -9))
    left.set(title="spikes per neuron and step, sorted", xlabel="neurons [%]", yscale="log")
    left.legend(fontsize=8, loc="lower center")
    for (by, found), marker, dash in zip(inside["ablation"].items(), "os", DASHES, strict=False):
        label, share = "at random" if by == "random" else f"by {by}", 100 * np.array(inside["fractions"])
        right.plot(share, found, marker=marker, ms=5, ls=dash, color=BLACK, label=label)
    right.axvline(100 * QUOTED["activity"]["removed_neurons"], color=GREY, lw=0.8)
    right.set(title="error without neurons, untrained; vertical: the paper's", xlabel="neurons removed [%]")
    right.set_ylabel("mean absolute error [°]")
    right.legend(fontsize=8)
    return figure


def fig8(numbers: Numbers) -> Figure:
    """Draw pitch estimated from manipulated inputs at a constant velocity, and its error."""
    found = numbers["manipulate"]
    truth = np.array(found["pitch_deg"])
    time = np.arange(len(truth)) * found["step_s"]
    figure, (above, below) = _panels(9.6, 4.6, 2, 1, sharex=True)
    above.plot(time, truth, color=BLACK, ls="--", lw=2.2, label="truth")
    for k, (way, label) in enumerate(RESPONSES.items()):
        pitch = np.array(found["networks"][SNN][way]["pitch_deg"])
        style: dict[str, Any] = {"color": COLOURS[k + 1], "ls": DASHES[k], "lw": 1.1, "label": label}
        above.plot(time, pitch, **style)
        below.plot(time, np.abs(pitch - truth), **style)
    above.set(ylabel="pitch [°]", title="pitch, Att-SNN")
    below.set(ylabel="error of pitch [°]", xlabel="time [s]", xlim=(0, time[-1]))
    figure.legend(*above.get_legend_handles_labels(), fontsize=8, ncols=5, loc="outside lower center")
    return figure


def fig9(numbers: Numbers) -> Figure:
    """Draw the time of an update with the paper's, and the modelled energy of a step."""
    taken = dict(sorted(numbers["latencies"].items(), key=lambda item: item[1][1]))
    layer = {"Loihi": "loihi_us", "PyTorch SNN": "snn_us", "GRU": "gru_us"}
    paper = {
        f"the paper's recurrent layer: {name}": QUOTED["recurrent_layer"][key] for name, key in layer.items()
    }
    figure, (left, right) = _panels(9.6, 4.4, 1, 2, width_ratios=(1.5, 1))
    for place, (name, (low, middle, high)) in enumerate(taken.items()):
        left.plot([low, high], [place, place], color=GREY, lw=3, solid_capstyle="butt")
        left.plot(middle, place, ls="", ms=6, color=look(name).colour, marker=look(name).marker)
        _note(left, f"{middle:.3g}", (high, place), (5, -3))
    for place, value in enumerate(paper.values(), len(taken)):
        left.plot(value, place, **DIAMOND)
        _note(left, f"{value:g}", (value, place), (8, -3))
    _name_rows(left, [*taken, *paper])
    left.axhline(len(taken) - 0.5, color=GREY, lw=0.8)
    left.axvline(5000, color=BLACK, lw=0.8, ls=":")
    left.set(title="one update; dotted: a sample at 200 Hz", xlabel="time [µs]", xscale="log")
    lines = numbers["inside"]["costs"]
    energy = [each["count"] * each["picojoules"] / 1e3 for each in lines]
    right.barh(range(len(energy)), energy, color=LIGHT, edgecolor=BLACK)
    for place, value in enumerate(energy):
        _note(right, f"{value:.2g}", (value, place), (4, -3), fontsize=8)
    _name_rows(right, [each["operation"] for each in lines])
    right.set_xlim(0, 1.2 * max(energy))
    right.set(title=f"modelled: {sum(energy):.0f} nJ per step", xlabel="[nJ]")
    return figure


FIGURES = {make.__name__: make for make in (fig4, fig5, fig6, fig7, fig8, fig9)}
"""Figures by item."""
