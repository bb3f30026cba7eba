"""Figures of a spiking network's inner life; each function returns one that the caller saves."""

from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from quadsim.dataset.figures import STYLE

from ..appearance import End, label_ends
from .activity import Activity
from .encoding_study import StimulusResponse, TuningCurves, preferred

Array = NDArray[np.float64]
COLOURS = ("#33658a", "#c0563b", "#e08a00", "#777777")
LAYERS = ("encoding", "hidden")
RASTER_S, MEMBRANE_S, SHOWN_S = 4.0, 1.0, 25.0


@matplotlib.rc_context(STYLE)
def rate_histograms(activity: Activity) -> Figure:
    """How many neurons spike how often, one panel a layer."""
    figure = Figure(figsize=(7.2, 2.6), layout="constrained")
    for k, axes in enumerate(figure.subplots(1, 2)):
        rates = activity.of_layer(activity.rates, k)
        axes.hist(rates, np.linspace(0, 1, 41), color=COLOURS[k])
        silent = int((rates < 1e-4).sum())
        axes.set(title=f"{LAYERS[k]}: mean {rates.mean():.3f}, {silent} silent")
        axes.set(xlabel="spikes per step", ylabel="neurons" if k == 0 else "")
    return figure


@matplotlib.rc_context(STYLE)
def raster(activity: Activity, truth: Array, rate_hz: float, start_s: float = 10.0) -> Figure:
    """Spikes of both layers over some seconds of the first flight, busiest neurons on top; attitude above."""
    steps = activity.spikes.shape[1]
    length = min(round(RASTER_S * rate_hz), steps)
    first = min(round(start_s * rate_hz), steps - length)
    time = (first + np.arange(length)) / rate_hz
    part = activity.spikes[0, first : first + length]
    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    top, *below = figure.subplots(3, 1, sharex=True, height_ratios=(1, 2.4, 2.4))
    per_sample = steps // len(truth)
    shown = np.degrees(np.repeat(truth, per_sample, axis=0)[first : first + length])
    estimate = np.degrees(np.repeat(activity.estimate[0], per_sample, axis=0)[first : first + length])
    for axis, (name, colour) in enumerate(zip(("roll", "pitch"), COLOURS, strict=False)):
        top.plot(time, shown[:, axis], color=colour, lw=0.9, label=name)
        top.plot(time, estimate[:, axis], color=colour, lw=0.9, ls=":", label=f"{name}, estimated")
    top.set(ylabel="[°]", xlim=(time[0], time[-1]))
    top.legend(ncols=4, fontsize=7, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0)
    for k, axes in enumerate(below):
        spikes = activity.of_layer(part, k)
        order = np.argsort(activity.of_layer(activity.rates, k), kind="stable")
        step, neuron = np.nonzero(spikes[:, order])
        axes.plot(time[step], neuron, "|", ms=1.6, mew=0.5, color=COLOURS[k])
        axes.set(title=LAYERS[k], ylabel="neuron, by rate", ylim=(-1, spikes.shape[1]))
        axes.grid(False)
    below[-1].set_xlabel("time [s]")
    return figure


@matplotlib.rc_context(STYLE)
def membranes(activity: Activity, rate_hz: float, start_s: float = 10.0) -> Figure:
    """Membrane potentials of four neurons of each layer, from rare to busy, with their spikes."""
    steps = len(activity.potentials)
    length = min(round(MEMBRANE_S * rate_hz), steps)
    first = min(round(start_s * rate_hz), steps - length)
    window = slice(first, first + length)
    time = (first + np.arange(length)) / rate_hz
    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    grid = figure.subplots(4, 2, sharex=True)
    for k in (0, 1):
        rates = activity.of_layer(activity.rates, k)
        awake = np.flatnonzero(rates > 1e-3)
        if awake.size == 0:
            continue
        ranked = awake[np.argsort(rates[awake])]
        chosen = ranked[np.rint(np.linspace(0.15, 0.9, 4) * (ranked.size - 1)).astype(int)]
        for axes, neuron in zip(grid[:, k], chosen, strict=True):
            _membrane(axes, time, activity, window, k, int(neuron))
        grid[0, k].set_title(LAYERS[k])
        grid[-1, k].set_xlabel("time [s]")
    figure.supylabel("potential over threshold", fontsize=9)
    return figure


@matplotlib.rc_context(STYLE)
def ablation_curve(
    fractions: Sequence[float], curves: Mapping[str, Array], tuned: Sequence[tuple[float, float]] = ()
) -> Figure:
    """Error against the share of neurons removed (the paper's Fig. 7), and after training on."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes = figure.subplots()
    ends = []
    styles = zip(COLOURS, ("-", "--", "-.", ":"), "os^D", strict=True)
    for (by, errors), (colour, dash, marker) in zip(curves.items(), styles, strict=False):
        axes.plot(
            100 * np.asarray(fractions),
            errors,
            color=colour,
            ls=dash,
            marker=marker,
            ms=5,
            mec="white",
            lw=1.8,
        )
        ends.append(End(float(errors[-1]), "at random" if by == "random" else f"by {by}", colour))
    if tuned:
        x, y = np.transpose(tuned)
        axes.plot(100 * x, y, "o-", color="#111111")
        ends.append(End(float(y[-1]), "trained on\nafter each cut", "#111111"))
    whole = next(iter(curves.values()))[0]
    axes.axhline(1.02 * whole, color="#111111", lw=0.8, ls=":")
    ends.append(End(1.02 * whole, "2 % more", "#111111"))
    axes.set(xlabel="neurons removed [%]", ylabel="mean absolute error [°]", yscale="log")
    axes.set_xlim(0, 100 * max([*fractions, *(share for share, _ in tuned)]))
    axes.set_yticks([2, 3, 5, 10, 20], ["2", "3", "5", "10", "20"])
    axes.minorticks_off()
    label_ends(axes, ends, size=10)
    return figure


@matplotlib.rc_context(STYLE)
def manipulated(found: Mapping[str, StimulusResponse], truth: Array, rate_hz: float) -> Figure:
    """Roll of the first flight estimated from manipulated inputs (the paper's Fig. 8)."""
    length = min(round(SHOWN_S * rate_hz), len(truth))
    time = np.arange(length) / rate_hz
    figure = Figure(figsize=(7.2, 1.5 * len(found)), layout="constrained")
    panels = np.atleast_1d(np.array(figure.subplots(len(found), 1, sharex=True)))
    for axes, (name, response) in zip(panels, found.items(), strict=True):
        axes.plot(time, np.degrees(truth[:length, 0]), color="#111111", lw=0.9, label="true roll")
        axes.plot(
            time, np.degrees(response.estimate[:length, 0]), color=COLOURS[1], lw=0.9, label="estimated"
        )
        axes.set(title=f"{name}: error {response.error_deg:.2f}°, gain {response.gain:.2f}", ylabel="[°]")
        axes.set_xlim(0, time[-1])
    panels[0].legend(ncols=2, fontsize=8, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0)
    panels[-1].set_xlabel("time [s]")
    return figure


@matplotlib.rc_context(STYLE)
def tuning(activity: Activity, curves: Mapping[str, TuningCurves]) -> Figure:
    """Rates of the hidden neurons against roll, pitch and their rates, sorted by what they follow."""
    best = activity.of_layer(preferred(dict(curves)), 1)
    figure = Figure(figsize=(7.4, 4.2), layout="constrained")
    panels = figure.subplots(1, len(curves), sharey=True)
    rates = {name: activity.of_layer(each.rates.T, 1).T for name, each in curves.items()}
    awake = np.flatnonzero(activity.of_layer(activity.rates, 1) > 1e-3)
    peak = {k: np.argmax(rates[name], axis=1) for k, name in enumerate(curves)}
    order = sorted(awake, key=lambda i: (best[i], peak[int(best[i])][i]))
    image = None
    for k, (axes, (name, curve)) in enumerate(zip(panels, curves.items(), strict=True)):
        shown = rates[name][order]
        spread = np.nanmax(np.abs(shown - np.nanmean(shown, axis=1, keepdims=True)), axis=1, keepdims=True)
        shown = (shown - np.nanmean(shown, axis=1, keepdims=True)) / np.maximum(spread, 0.02)
        image = axes.imshow(shown, aspect="auto", cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
        ticks = [0, len(curve.centres) // 2, len(curve.centres) - 1]
        axes.set_xticks(ticks, [f"{round(curve.centres[i])}" for i in ticks])
        own = [place for place, i in enumerate(order) if best[i] == k]
        if own:
            axes.plot([-0.5, -0.5], [own[0] - 0.5, own[-1] + 0.5], color="#111111", lw=5, clip_on=False)
        unit = "°/s" if "rate" in name else "°"
        axes.set(title=name, xlabel=f"[{unit}]", ylabel="hidden neuron" if k == 0 else "")
        axes.grid(False)
    if image is not None:
        figure.colorbar(image, ax=panels, label="rate, over its mean and range", shrink=0.8)
    return figure


def _membrane(axes: Axes, time: Array, activity: Activity, window: slice, layer: int, neuron: int) -> None:
    potential = activity.of_layer(activity.potentials, layer)[window, neuron]
    spikes = activity.of_layer(activity.spikes[0], layer)[window, neuron] > 0
    axes.plot(time, potential, color=COLOURS[layer], lw=0.8)
    axes.plot(time[spikes], np.ones(spikes.sum()), "|", color="#111111", ms=5)
    axes.axhline(1.0, color="#999999", lw=0.6, ls=":")
    low, high = float(potential.min()), 1.15
    axes.set(ylim=(low - 0.05 * (high - low), high), xlim=(time[0], time[-1]))
    axes.set_ylabel(f"{neuron}", rotation=0, labelpad=10)
