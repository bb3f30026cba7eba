"""Figures, drawn from the stages' numbers; distinguished by line, marker and hatching, for grey too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, NullFormatter

from estimators.appearance import Look, look
from quadsim.dataset.figures import LINES

from .claims import NETWORKS, TOLERANCE, Numbers, by_rate, pooled, scatter
from .plan import FLOAT, PAPER, RESCALED, RNN, SNN, TEST, TRAINED_ON
from .quoted import CHIP, CONVERGE_S, PYTORCH_US, REMOVABLE, TEST_DEG
from .scores import CONVERGED_DEG, FILTERS, RESPONSE_S, SHIPPED, SHOWN_HZ, SIX

PLAIN = FuncFormatter(lambda value, _: f"{value:g}")
BLACK, GREY, LIGHT = "#111111", "#999999", "#d9d9d9"
COLOURS = (BLACK, "#0072b2", "#e08a00", "#7a5195", "#6b6b6b", "#c0563b", "#2f8f6b", "#a05a2c")
DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)), (0, (3, 1)))
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
HATCHES = ("", "///", "...", "xxx", "\\\\\\")
QUOTED: dict[str, Any] = {"marker": "D", "ls": "", "mfc": "white", "color": BLACK, "ms": 5}
"""How the paper's values are drawn."""
DOMAIN_TITLES = {"sim": "Hummingbird, ADIS16448", "real": "px4-quad, Pixhawk 4 Mini"}
CURVES = {
    SNN: "Att-SNN, on the chip's grid",
    FLOAT: "Att-SNN, floats",
    PAPER: "Att-SNN, the paper's recipe",
    RNN: "Att-RNN",
}
SAME = {
    SNN: "att-snn-loihi",
    FLOAT: "att-snn",
    PAPER: "att-snn-paper",
    RNN: "att-rnn",
    "att-snn, shipped": "att-snn-loihi",
    RESCALED: "att-snn",
    TRAINED_ON: "att-snn-loihi",
}
"""Networks of the paper, and the estimator whose look they have."""


def _panels(width: float, height: float, *shape: int, **options: Any) -> tuple[Figure, Any]:
    """A figure of a size [inch] and its axes."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(*shape, **options)


def _look(name: str) -> Look:
    """Colour, dash and marker of a method."""
    return look(SAME.get(name, name))


def _marked(k: int, size: float = 5) -> dict[str, Any]:
    """Colour, dash and marker of the k-th line of a figure that does not compare methods."""
    return {"color": COLOURS[k], "ls": DASHES[k], "marker": MARKS[k], "ms": size}


def _note(axes: Axes, text: str, at: tuple[float, float], shift: tuple[float, float], **options: Any) -> None:
    """Write small text beside a point, shifted by so many points."""
    style: dict[str, Any] = {"fontsize": 7} | options
    axes.annotate(text, at, shift, textcoords="offset points", **style)


def _name_rows(axes: Axes, names: Sequence[str], size: float = 8) -> None:
    """Name horizontal bars, the first on top."""
    axes.set_yticks(range(len(names)), names, fontsize=size)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)


def fig3(numbers: Numbers) -> Figure:
    """Inputs and outputs of both domains."""
    groups = (
        ("Gyroscope", "rad/s", ("gyro x", "gyro y", "gyro z")),
        ("Accelerometer x, y", "m/s²", ("accel x", "accel y")),
        ("Accelerometer z", "m/s²", ("accel z",)),
        ("Attitude", "°", ("roll", "pitch")),
    )
    figure, panels = _panels(9.6, 4.4, 2, 4)
    for row, (domain, title) in zip(panels, DOMAIN_TITLES.items(), strict=True):
        for axes, (group, unit, names) in zip(row, groups, strict=True):
            for name, (colour, dash) in zip(names, LINES, strict=False):
                each = numbers["distributions"][domain][f"{name} [{unit}]"]
                label = f"{name.split()[-1]}, SD {each['sd']:.2f}"
                axes.stairs(each["density"], each["edges"], color=colour, ls=dash, label=label)
            axes.set(xlabel=f"[{unit}]", title=group if domain == "sim" else "", yticks=[])
            axes.set_ylim(0, 1.5 * axes.get_ylim()[1])
            axes.legend(fontsize=7, loc="upper right", borderaxespad=0)
        row[0].set_ylabel(f"{title}\ndensity")
    return figure


def fig4(numbers: Numbers) -> Figure:
    """Training and validation loss of four networks, and the scatter of the latter."""
    figure, panels = _panels(9.6, 3.4, 1, 3, width_ratios=(1, 1, 0.6))
    *curves, bars = panels
    for axes, kind, title in zip(
        curves, ("train_mse", "val_mse"), ("training windows", "validation flights"), strict=True
    ):
        for stage, label in CURVES.items():
            style = _look(stage).line | {"lw": 1.1}
            axes.plot(numbers[stage]["updates"], numbers[stage][kind], label=label, **style)
        axes.set(title=title, xlabel="updates", xscale="log", yscale="log")
        axes.xaxis.set_major_formatter(PLAIN)
    curves[0].set_ylabel("mean square error [rad²]")
    curves[0].legend(fontsize=7, loc="upper right")
    for k, stage in enumerate(CURVES):
        size = 100 * scatter(numbers[stage]["val_mse"])
        bars.barh(k, size, color=_look(stage).colour, edgecolor=BLACK, hatch=HATCHES[k])
    _name_rows(bars, [label.replace(", ", ",\n") for label in CURVES.values()], 7)
    bars.set(title="scatter of validation", xlabel="epoch to epoch [%]")
    return figure


def fig5(numbers: Numbers) -> Figure:
    """Error of every test flight, with an unknown and, for filters, a known start."""
    names = [*SIX, *SHIPPED]
    figure, axes = _panels(8.4, 3.6)
    handles: list[Artist] = []
    for shift, start, hatch, colour in ((-0.2, "unknown", "////", LIGHT), (0.2, "known", "", "#8f8f8f")):
        shown = [name for name in names if start == "unknown" or not name.startswith("att")]
        data = [pooled(numbers, "test-", name, start) for name in shown]
        positions = [names.index(name) + shift for name in shown]
        parts = axes.violinplot(data, positions=positions, widths=0.36, showmedians=True)
        for body in parts["bodies"]:
            body.set(facecolor=colour, edgecolor=BLACK, alpha=1.0, hatch=hatch, linewidth=0.7)
        for part in ("cmedians", "cmins", "cmaxes", "cbars"):
            parts[part].set(color=BLACK, linewidth=1.0)
        handles.append(Patch(facecolor=colour, edgecolor=BLACK, hatch=hatch, label=f"{start} start"))
    places = [names.index(name) for name in TEST_DEG]
    handles += axes.plot(places, list(TEST_DEG.values()), **QUOTED, zorder=5, label="the paper, its flights")
    axes.set_xticks(range(len(names)), [name.replace(", ", ",\n") for name in names], fontsize=8)
    axes.set(ylabel="mean absolute error of a flight [°]")
    axes.set_ylim(bottom=0)
    axes.grid(axis="x", visible=False)
    axes.legend(handles=handles, fontsize=8)
    return figure


def fig6(numbers: Numbers) -> Figure:
    """Inclination error after a start with an error of 20°."""
    curves = numbers["recover"]["curves"]
    figure, panels = _panels(9.6, 3.6, 1, 2, sharey=True)
    titles = ("in flight, tilted by 20°, believed level", "in hover, filters given a roll of 20°")
    for axes, kind, title in zip(panels, ("flight", "hover"), titles, strict=True):
        for k, name in enumerate((*FILTERS, *NETWORKS)):
            if kind in curves[name]:
                error = curves[name][kind]["median"]
                style = {"ms": 4, "lw": 2.0 if name == "att-snn" else 1.1, "markevery": (5 * k, 40)}
                axes.plot(np.arange(len(error)) / SHOWN_HZ, error, label=name, **style, **_look(name).points)
        axes.axhline(CONVERGED_DEG, color=BLACK, lw=0.8, ls=":")
        for (key, seconds), sign in zip(CONVERGE_S.items(), "<>", strict=True):
            axes.axvline(seconds, color=GREY, lw=0.8)
            _note(axes, f"the paper: {key} {sign} {seconds:g} s", (seconds, 27), (3, 0), color="#555555")
        axes.set(title=title, xlabel="time [s]", xlim=(0, RESPONSE_S), ylim=(0, 30))
    panels[0].set_ylabel("inclination error, median start [°]")
    figure.legend(*panels[0].get_legend_handles_labels(), fontsize=8, ncols=7, loc="outside lower center")
    return figure


def fig7(numbers: Numbers) -> Figure:
    """How often neurons spike, and the error with some removed."""
    inside = numbers["inside"]
    figure, (left, right) = _panels(9.6, 3.2, 1, 2)
    styles: dict[str, dict[str, Any]] = {
        "encoding": {"color": LIGHT, "edgecolor": BLACK, "hatch": "////"},
        "hidden": {"color": "#6b6b6b", "alpha": 0.75},
    }
    for rates, (layer, style) in zip(inside["rates"], styles.items(), strict=True):
        label = f"{layer}, mean {np.mean(rates):.2f}"
        left.hist(rates, np.linspace(0, 1, 26), label=label, linewidth=0.7, **style)
    left.set(title="spiking", xlabel="spikes per step", ylabel="neurons")
    left.legend(fontsize=8)
    for k, (by, errors) in enumerate(inside["ablation"].items()):
        label = "at random" if by == "random" else f"by {by}"
        right.plot(100 * np.array(inside["fractions"]), errors, label=label, **_marked(k, 4))
    complete = next(iter(inside["ablation"].values()))[0]
    right.axhline(TOLERANCE * complete, color=BLACK, lw=0.8, ls=":")
    right.axvline(100 * REMOVABLE, color=GREY, lw=0.8)
    right.set(title="ablation, nothing trained again", xlabel="neurons removed [%]", yscale="log")
    right.set_ylabel("mean absolute error [°]")
    right.yaxis.set_major_formatter(PLAIN)
    right.yaxis.set_minor_formatter(PLAIN)
    right.legend(fontsize=8)
    return figure


def fig8(numbers: Numbers) -> Figure:
    """Roll estimated from manipulated inputs."""
    inside = numbers["inside"]
    responses = inside["responses"]
    time = np.arange(len(inside["roll_deg"])) * inside["step_s"]
    figure, panels = _panels(8.0, 1.35 * len(responses) + 0.3, len(responses), 1, sharex=True)
    for axes, (name, each) in zip(panels, responses.items(), strict=True):
        axes.plot(time, inside["roll_deg"], color=GREY, lw=1.6, label="true roll")
        axes.plot(time, each["roll_deg"], color=BLACK, lw=0.8, ls="-", label="estimated")
        axes.set_title(
            f"{name}: error {each['error_deg']:.2f}°, gain below 0.2 Hz {each['slow_gain']:.2f}, "
            f"above 1 Hz {each['fast_gain']:.2f}"
        )
        axes.set(ylabel="[°]", xlim=(0, time[-1]))
    panels[0].legend(ncols=2, fontsize=7, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0)
    panels[-1].set_xlabel("time [s]")
    return figure


def fig9(numbers: Numbers) -> Figure:
    """Time of an update, and the modelled energy of a step."""
    from estimators.analysis.latency import point  # imports torch

    taken = sorted(numbers["latencies"].items(), key=lambda item: item[1][1])
    paper = {"the paper: Loihi": CHIP["µs"]} | {f"the paper: {name}": us for name, us in PYTORCH_US.items()}
    figure, (left, right) = _panels(9.6, 4.4, 1, 2, width_ratios=(1.5, 1))
    for place, (name, (low, middle, high)) in enumerate(taken):
        left.plot([low, high], [place, place], color=GREY, lw=3, solid_capstyle="butt")
        left.plot(middle, place, ls="", ms=6, **point(name))
        _note(left, f"{middle:.3g}", (high, place), (5, -3))
    for place, value in enumerate(paper.values(), len(taken)):
        left.plot(value, place, **QUOTED)
        _note(left, f"{value:g}", (value, place), (8, -3))
    _name_rows(left, [*(name for name, _ in taken), *paper])
    left.axhline(len(taken) - 0.5, color=GREY, lw=0.8)
    left.axvline(5000, color=BLACK, lw=0.8, ls=":")
    left.set(title="one update from Python; dotted: a sample at 200 Hz", xlabel="time [µs]", xscale="log")
    lines = numbers["inside"]["costs"]
    energy = [each["count"] * each["picojoules"] / 1e3 for each in lines]
    for place, (value, hatch) in enumerate(zip(energy, HATCHES, strict=True)):
        right.barh(place, value, color=LIGHT, edgecolor=BLACK, hatch=hatch)
        _note(right, f"{value:.2g}", (value, place), (4, -3), fontsize=8)
    _name_rows(right, [each["operation"] for each in lines])
    right.set_xlim(0, 1.2 * max(energy))
    right.set(title=f"modelled energy of a step, {sum(energy):.0f} nJ", xlabel="[nJ]")
    return figure


def loop(numbers: Numbers) -> Figure:
    """Error of the estimate in the loop, in equal parts of the flights."""
    scenarios = numbers["loop"]["scenarios"]
    figure, panels = _panels(9.0, 3.0, 1, len(scenarios))
    for axes, (scenario, scores) in zip(panels, scenarios.items(), strict=True):
        for name in (name for name in scores if name != "truth"):
            axes.plot([1, 2, 3], scores[name]["parts_deg"], label=name, ms=5, **_look(name).points)
        axes.set(title=scenario, xlabel="third of the flight", xticks=[1, 2, 3], xlim=(0.7, 3.3))
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("mean absolute error [°]")
    figure.legend(*panels[0].get_legend_handles_labels(), fontsize=8, loc="outside right center")
    return figure


def rate(numbers: Numbers) -> Figure:
    """Error against the sample rate."""
    by_hz = by_rate(numbers)
    figure, axes = _panels(6.4, 3.4)
    for name in next(iter(by_hz.values())):
        errors = [each[name] for each in by_hz.values()]
        axes.plot(list(by_hz), errors, label=name, ms=5, **_look(name).points)
    axes.set(xscale="log", yscale="log", xlabel="sample rate [Hz]", ylabel="mean absolute error [°]")
    axes.set_xticks(list(by_hz), [f"{rate:g}" for rate in by_hz])
    axes.minorticks_off()
    errors = [error for each in by_hz.values() for error in each.values()]
    ticks = [t for t in (1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30) if 0.7 * min(errors) < t < 1.4 * max(errors)]
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.legend(fontsize=8)
    return figure


def _compared(stage: Mapping[str, Any], places: Sequence[float], label: str) -> Figure:
    """Errors of networks on both test sets against a size, a filter's as a line."""
    figure, axes = _panels(6.4, 3.4)
    sets = ("unseen Hummingbird flights", "the second domain, never trained on")
    for k, (flights, title) in enumerate(zip(TEST, sets, strict=True)):
        errors = [stage["errors"][name][flights] for name in stage["sizes"]]
        means, deviations = np.mean(errors, axis=1), np.std(errors, axis=1)
        axes.errorbar(places, means, deviations, capsize=3, label=title, **_marked(k))
    if "mahony" in stage["errors"]:
        level = np.mean(stage["errors"]["mahony"][TEST[0]])
        axes.axhline(level, color="#6b6b6b", lw=1.0, ls=":")
        _note(axes, "mahony, Hummingbird", (places[-1], level), (0, 3), ha="right")
    axes.set(xscale="log", xlabel=label, ylabel="mean absolute error [°]")
    axes.set_xticks(places, [f"{place:.2g}" if place < 100 else f"{place:g}" for place in places])
    axes.minorticks_off()
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8)
    return figure


def size(numbers: Numbers) -> Figure:
    """Error against the number of neurons."""
    stage = numbers["compare-size"]
    return _compared(stage, [neurons for neurons, _ in stage["sizes"].values()], "neurons of both layers")


def minutes(numbers: Numbers) -> Figure:
    """Error against the minutes of flight trained on."""
    stage = numbers["compare-minutes"]
    places = [int(flights) * stage["duration_s"] / 60 for flights in stage["sizes"]]
    return _compared(stage, places, "minutes of flight trained on")


FIGURES = {
    make.__name__: make for make in (fig3, fig4, fig5, fig6, fig7, fig8, fig9, loop, rate, size, minutes)
}
"""Figure of each item that has one."""
