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

from quadsim.dataset.figures import LINES

from .claims import Numbers, by_rate, pooled, scatter
from .plan import FLOAT, PAPER, RNN, SNN
from .quoted import CHIP, CONVERGE_S, PYTORCH_US, REMOVABLE, TEST_DEG
from .scores import BELOW_DEG, SHIPPED, SHOWN_HZ, SIX

PLAIN = FuncFormatter(lambda value, _: f"{value:g}")
COLOURS = ("#111111", "#0072b2", "#e08a00", "#7a5195", "#6b6b6b", "#c0563b", "#2f8f6b", "#a05a2c")
DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)), (0, (3, 1)))
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
DOMAIN_TITLES = {"sim": "Hummingbird, ADIS16448", "real": "px4-quad, Pixhawk 4 Mini"}
CURVES = {
    SNN: "Att-SNN, on the chip's grid",
    FLOAT: "Att-SNN, floats",
    PAPER: "Att-SNN, the paper's recipe",
    RNN: "Att-RNN",
}


def look(k: int) -> dict[str, Any]:
    """Colour and dash of the k-th line."""
    return {"color": COLOURS[k % len(COLOURS)], "ls": DASHES[k % len(DASHES)]}


def distributions(numbers: Numbers) -> Figure:
    """Inputs and outputs of both domains (Fig. 3)."""
    groups = (
        ("Gyroscope", "rad/s", ("gyro x", "gyro y", "gyro z")),
        ("Accelerometer x, y", "m/s²", ("accel x", "accel y")),
        ("Accelerometer z", "m/s²", ("accel z",)),
        ("Attitude", "°", ("roll", "pitch")),
    )
    found = numbers["distributions"]
    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    for row, (domain, title) in zip(figure.subplots(2, 4), DOMAIN_TITLES.items(), strict=True):
        for axes, (group, unit, names) in zip(row, groups, strict=True):
            for name, (colour, dash) in zip(names, LINES, strict=False):
                each = found[domain][f"{name} [{unit}]"]
                label = f"{name.split()[-1]}, SD {each['sd']:.2f}"
                axes.stairs(each["density"], each["edges"], color=colour, ls=dash, label=label)
            axes.set(xlabel=f"[{unit}]", title=group if domain == "sim" else "", yticks=[])
            axes.set_ylim(0, 1.5 * axes.get_ylim()[1])
            axes.legend(fontsize=7, loc="upper right", borderaxespad=0)
        row[0].set_ylabel(f"{title}\ndensity")
    return figure


def losses(numbers: Numbers) -> Figure:
    """Training and validation loss of four networks, and how much the latter scatters (Fig. 4)."""
    figure = Figure(figsize=(9.6, 3.4), layout="constrained")
    panels = figure.subplots(1, 3, width_ratios=(1, 1, 0.6))
    for k, (stage, label) in enumerate(CURVES.items()):
        each = numbers[stage]
        for axes, kind in zip(panels, ("train_mse", "val_mse"), strict=False):
            axes.plot(each["updates"], each[kind], label=label, lw=1.1, **look(k))
        panels[2].barh(k, 100 * scatter(each["val_mse"]), color="#bbbbbb", edgecolor="#111111",
                       hatch=("", "///", "...", "xxx")[k])  # fmt: skip
    for axes, title in zip(panels, ("training windows", "validation flights"), strict=False):
        axes.set(title=title, xlabel="updates", xscale="log", yscale="log")
        axes.xaxis.set_major_formatter(PLAIN)
    panels[0].set_ylabel("mean square error [rad²]")
    panels[0].legend(fontsize=7, loc="upper right")
    panels[2].set_yticks(
        range(len(CURVES)), [label.replace(", ", ",\n") for label in CURVES.values()], fontsize=7
    )
    panels[2].invert_yaxis()
    panels[2].grid(axis="y", visible=False)
    panels[2].set(title="scatter of validation", xlabel="epoch to epoch [%]")
    return figure


def violins(numbers: Numbers) -> Figure:
    """Error of every test flight, with an unknown and, for filters, a known start (Fig. 5)."""
    names = [*SIX, *SHIPPED]
    figure = Figure(figsize=(8.4, 3.6), layout="constrained")
    axes = figure.subplots()
    handles: list[Artist] = []
    for shift, start, hatch, colour in ((-0.2, "unknown", "////", "#d9d9d9"), (0.2, "known", "", "#8f8f8f")):
        shown = [name for name in names if start == "unknown" or not name.startswith("att")]
        data = [pooled(numbers, "test-", name, start) for name in shown]
        positions = [names.index(name) + shift for name in shown]
        parts = axes.violinplot(data, positions=positions, widths=0.36, showmedians=True)
        for body in parts["bodies"]:  # type: ignore[union-attr]  # matplotlib's stub names one collection
            body.set(facecolor=colour, edgecolor="#111111", alpha=1.0, hatch=hatch, linewidth=0.7)
        for part in ("cmedians", "cmins", "cmaxes", "cbars"):
            parts[part].set(color="#111111", linewidth=1.0)
        handles.append(Patch(facecolor=colour, edgecolor="#111111", hatch=hatch, label=f"{start} start"))
    for name, value in TEST_DEG.items():
        axes.plot(names.index(name), value, "D", mfc="white", color="#111111", ms=5, zorder=5)
    handles += axes.plot([], [], "D", mfc="white", color="#111111", label="the paper, its flights")
    axes.set_xticks(range(len(names)), [name.replace(", ", ",\n") for name in names], fontsize=8)
    axes.set(ylabel="mean absolute error of a flight [°]")
    axes.set_ylim(bottom=0)
    axes.grid(axis="x", visible=False)
    axes.legend(handles=handles, fontsize=8)
    return figure


def recoveries(numbers: Numbers) -> Figure:
    """Inclination error after a start that is 20° off (Fig. 6)."""
    found = numbers["recover"]["found"]
    names = ["complementary", "complementary-adaptive", "mahony", "madgwick", "ekf", "att-rnn", "att-snn"]
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    titles = {
        "flight": "in flight, tilted by 20°, believed level",
        "hover": "in hover, filters given a roll of 20°",
    }
    for axes, (kind, title) in zip(panels, titles.items(), strict=True):
        for k, name in enumerate(names):
            if kind not in found[name]:
                continue
            curve = np.array(found[name][kind]["median"])
            style = look(k) | ({"lw": 2.0} if name == "att-snn" else {"lw": 1.1})
            axes.plot(
                np.arange(curve.size) / SHOWN_HZ, curve, label=name, marker=MARKS[k], ms=4,
                markevery=(5 * k, 40),
                **style,
            )  # fmt: skip
        axes.axhline(BELOW_DEG, color="#111111", lw=0.8, ls=":")
        for key, ha in (("networks", "left"), ("filters", "left")):
            axes.axvline(CONVERGE_S[key], color="#999999", lw=0.8)
            sign = "<" if key == "networks" else ">"
            axes.annotate(
                f"the paper: {key} {sign} {CONVERGE_S[key]:g} s", (CONVERGE_S[key], 27), (3, 0), fontsize=7,
                textcoords="offset points", color="#555555", ha=ha,
            )  # fmt: skip
        axes.set(title=title, xlabel="time [s]", xlim=(0, 15), ylim=(0, 30))
    panels[0].set_ylabel("inclination error, median start [°]")
    figure.legend(*panels[0].get_legend_handles_labels(), fontsize=8, ncols=7, loc="outside lower center")
    return figure


def spiking(numbers: Numbers) -> Figure:
    """How often neurons spike, and what it costs to leave some out (Fig. 7)."""
    inside = numbers["inside"]
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    bins = np.linspace(0, 1, 26)
    for rates, label, style in zip(
        inside["rates"],
        ("encoding", "hidden"),
        ({"color": "#d9d9d9", "edgecolor": "#111111", "hatch": "////"}, {"color": "#6b6b6b", "alpha": 0.75}),
        strict=True,
    ):
        left.hist(rates, bins, label=f"{label}, mean {np.mean(rates):.2f}", linewidth=0.7, **style)
    left.set(title="spiking", xlabel="spikes per step", ylabel="neurons")
    left.legend(fontsize=8)
    fractions = 100 * np.array(inside["fractions"])
    for k, (by, errors) in enumerate(inside["ablation"].items()):
        label = "at random" if by == "random" else f"by {by}"
        right.plot(fractions, errors, label=label, marker=MARKS[k], ms=4, **look(k))
    whole = next(iter(inside["ablation"].values()))[0]
    right.axhline(1.02 * whole, color="#111111", lw=0.8, ls=":")
    right.axvline(100 * REMOVABLE, color="#999999", lw=0.8)
    right.set(title="ablation, nothing trained again", xlabel="neurons removed [%]", yscale="log")
    right.set_ylabel("mean absolute error [°]")
    right.yaxis.set_major_formatter(PLAIN)
    right.yaxis.set_minor_formatter(PLAIN)
    right.legend(fontsize=8)
    return figure


def manipulated(numbers: Numbers) -> Figure:
    """Roll estimated from manipulated inputs (Fig. 8)."""
    inside = numbers["inside"]
    responses = inside["responses"]
    truth = np.array(inside["roll_deg"])
    time = np.arange(truth.size) * inside["step_s"]
    figure = Figure(figsize=(8.0, 1.35 * len(responses) + 0.3), layout="constrained")
    panels = figure.subplots(len(responses), 1, sharex=True)
    for axes, (name, each) in zip(panels, responses.items(), strict=True):
        axes.plot(time, truth, color="#999999", lw=1.6, label="true roll")
        axes.plot(time, each["roll_deg"], color="#111111", lw=0.8, ls="-", label="estimated")
        axes.set_title(
            f"{name}: error {each['error_deg']:.2f}°, gain below 0.2 Hz {each['slow_gain']:.2f}, "
            f"above 1 Hz {each['fast_gain']:.2f}"
        )
        axes.set(ylabel="[°]", xlim=(0, time[-1]))
    panels[0].legend(ncols=2, fontsize=7, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0)
    panels[-1].set_xlabel("time [s]")
    return figure


def costs(numbers: Numbers) -> Figure:
    """Time of an update, and the modelled energy of a step (Fig. 9)."""
    taken = numbers["latencies"]["µs"]
    order = sorted(taken, key=lambda name: taken[name][1])
    paper = {"Loihi": CHIP["µs"], **PYTORCH_US}
    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    for place, name in enumerate(order):
        low, middle, high = taken[name]
        left.plot([low, high], [place, place], color="#999999", lw=3, solid_capstyle="butt")
        left.plot(middle, place, "o", color="#111111", ms=5)
        left.annotate(f"{middle:.3g}", (high, place), (5, -3), textcoords="offset points", fontsize=7)
    for place, value in enumerate(paper.values(), len(order)):
        left.plot(value, place, "D", mfc="white", color="#111111", ms=5)
        left.annotate(f"{value:g}", (value, place), (8, -3), textcoords="offset points", fontsize=7)
    left.set_yticks(
        range(len(order) + len(paper)), [*order, *(f"the paper: {name}" for name in paper)], fontsize=8
    )
    left.axhline(len(order) - 0.5, color="#999999", lw=0.8)
    left.axvline(5000, color="#111111", lw=0.8, ls=":")
    left.invert_yaxis()
    left.set(title="one update from Python; dotted: a sample at 200 Hz", xlabel="time [µs]", xscale="log")
    left.grid(axis="y", visible=False)
    lines = numbers["inside"]["costs"]
    energy = [each["count"] * each["picojoules"] / 1e3 for each in lines]
    hatches = ("", "///", "...", "xxx", "\\\\\\")
    right.barh(range(len(lines)), energy, color="#d9d9d9", edgecolor="#111111")
    for place, (bar, hatch) in enumerate(zip(right.patches, hatches, strict=False)):
        bar.set_hatch(hatch)
        right.annotate(
            f"{energy[place]:.2g}", (energy[place], place), (4, -3), textcoords="offset points", fontsize=8
        )
    right.set_yticks(range(len(lines)), [each["operation"] for each in lines], fontsize=8)
    right.set_xlim(0, 1.2 * max(energy))
    right.invert_yaxis()
    right.grid(axis="y", visible=False)
    right.set(title=f"modelled energy of a step, {sum(energy):.0f} nJ", xlabel="[nJ]")
    return figure


def loops(numbers: Numbers) -> Figure:
    """Error of the estimate in the loop, in equal parts of the flights."""
    loop = numbers["loop"]
    figure = Figure(figsize=(9.0, 3.0), layout="constrained")
    panels = np.atleast_1d(np.array(figure.subplots(1, len(loop["found"]))))
    for axes, (scenario, found) in zip(panels, loop["found"].items(), strict=True):
        names = [name for name in found if name != "truth"]
        for k, name in enumerate(names):
            parts = found[name]["parts_deg"]
            axes.plot(np.arange(1, len(parts) + 1), parts, marker=MARKS[k], label=name, ms=5, **look(k))
        axes.set(title=scenario, xlabel="third of the flight", xticks=[1, 2, 3], xlim=(0.7, 3.3))
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("mean absolute error [°]")
    figure.legend(*panels[0].get_legend_handles_labels(), fontsize=8, loc="outside right center")
    return figure


def rates(numbers: Numbers) -> Figure:
    """Error against the sample rate."""
    found = by_rate(numbers)
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    axes = figure.subplots()
    labels = {"rescaled": "Att-SNN, rescaled", "trained on": "Att-SNN, rescaled and trained on"}
    for k, name in enumerate(next(iter(found.values()))):
        errors = [each[name] for each in found.values()]
        axes.plot(list(found), errors, marker=MARKS[k], ms=5, label=labels.get(name, name), **look(k))
    axes.set(xscale="log", yscale="log", xlabel="sample rate [Hz]", ylabel="mean absolute error [°]")
    axes.set_xticks(list(found), [f"{rate:g}" for rate in found])
    axes.minorticks_off()
    values = [error for each in found.values() for error in each.values()]
    _degree_ticks(axes, values)
    axes.legend(fontsize=8)
    return figure


def _degree_ticks(axes: Axes, values: Sequence[float]) -> None:
    ticks = [t for t in (1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30) if 0.7 * min(values) < t < 1.4 * max(values)]
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes.yaxis.set_minor_formatter(NullFormatter())


def _front(numbers: Mapping[str, Any], places: Sequence[float], label: str) -> Figure:
    """Errors on both test sets against a size."""
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    axes = figure.subplots()
    names = list(numbers["sizes"])
    values = []
    for k, (stage, said) in enumerate(
        (
            ("fly-test-sim", "unseen Hummingbird flights"),
            ("fly-test-real", "the second domain, never trained on"),
        )
    ):
        means = [np.mean(numbers["errors"][name][stage]) for name in names]
        spreads = [np.std(numbers["errors"][name][stage]) for name in names]
        axes.errorbar(places, means, spreads, marker=MARKS[k], ms=5, capsize=3, label=said, **look(k))
        for filter_name in [name for name in numbers["errors"] if name not in names][:1] if k == 0 else []:
            level = float(np.mean(numbers["errors"][filter_name][stage]))
            axes.axhline(level, color="#6b6b6b", lw=1.0, ls=":")
            axes.annotate(f"{filter_name}, Hummingbird", (places[-1], level), (0, 3), fontsize=7, ha="right",
                          textcoords="offset points")  # fmt: skip
            values.append(level)
        values += [float(mean) for mean in means]
    axes.set(xscale="log", xlabel=label, ylabel="mean absolute error [°]")
    axes.set_xticks(places, [f"{place:.2g}" if place < 100 else f"{place:g}" for place in places])
    axes.minorticks_off()
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8)
    return figure


def sizes(numbers: Numbers) -> Figure:
    """Error against the number of neurons."""
    found = numbers["compare-size"]
    return _front(found, [size[0] for size in found["sizes"].values()], "neurons of both layers")


def minutes(numbers: Numbers, flight_s: float) -> Figure:
    """Error against the minutes of flight trained on."""
    found = numbers["compare-minutes"]
    return _front(found, [int(n) * flight_s / 60 for n in found["sizes"]], "minutes of flight trained on")
