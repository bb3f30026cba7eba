"""The inner life of a spiking network: what its neurons do, what they encode, and which of them matter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from quadsim.dataset.figures import STYLE
from quadsim.runs.files import save_figure

from ..evaluation.flights import Flights
from ..networks.forward import OnLoihi
from ..networks.network import NetworkEstimator, Spiking
from ..networks.weights_file import NetworkConfig, Tensors
from .ablation import CRITERIA, ablation, importance
from .activity import LAYERS, Activity, record
from .encoding_study import StimulusResponse, TuningCurves, preferred, responses, tuning_curves
from .energy import Cost, costs, counts

Array = NDArray[np.float64]
FRACTIONS = tuple(np.round(np.arange(0.0, 0.65, 0.05), 2))
"""Shares of the neurons that the ablation curve removes."""
SILENT = 1e-4
"""Spikes per step below which a neuron counts as silent."""
COLOURS = ("#33658a", "#c0563b", "#e08a00", "#777777")
RASTER_S = 4.0


@dataclass(frozen=True)
class Inspection:
    """A network over recorded flights."""

    config: NetworkConfig
    core: OnLoihi
    activity: Activity
    costs: list[Cost]
    responses: dict[str, StimulusResponse]
    tuning: dict[str, TuningCurves]
    ablation: dict[str, Array]
    """Criterion to the error at each of FRACTIONS [deg]."""
    truth: Array
    """Of the first flight (T, 2) [rad]."""

    def layer_rates(self, layer: int) -> Array:
        """Spikes per step of the neurons of a layer."""
        return self.activity.of_layer(self.activity.rates, layer)

    def summary(self) -> list[tuple[str, str]]:
        """What a terminal shows."""
        parts, best = [], preferred(self.tuning)
        for k, layer in enumerate(LAYERS):
            rates = self.layer_rates(k)
            silent, busy = int((rates < SILENT).sum()), int((rates > 0.9).sum())
            said = f"{rates.mean():.3f} spikes per neuron and step, {silent} silent, {busy} almost always on"
            parts.append((f"{layer} layer", said))
            found = np.bincount(self.activity.of_layer(best, k), minlength=len(self.tuning))
            said = ", ".join(f"{name} {count}" for name, count in zip(self.tuning, found, strict=True))
            parts.append((f"{layer} neurons follow most", said))
        parts += [(f"error, {name}", f"{each.error_deg:.2f}°") for name, each in self.responses.items()]
        for by, errors in self.ablation.items():
            most = max(f for f, error in zip(FRACTIONS, errors, strict=True) if error <= 1.02 * errors[0])
            parts.append((f"removed by {by} for < 2 %", f"{100 * most:.0f} % of the neurons, untrained"))
        energy = sum(line.nanojoules for line in self.costs)
        parts += [(f"{each.operation}, a step", f"{each.count:.4g}") for each in self.costs]
        return [*parts, ("modelled dynamic energy", f"{energy:.0f} nJ a step")]

    def draw(self, folder: str | Path) -> None:
        """Write a raster, tuning curves and the ablation curve into a folder."""
        raster = raster_figure(self.activity, self.truth, self.config.rate_hz)
        save_figure(Path(folder) / "raster.png", raster)
        save_figure(Path(folder) / "tuning.png", tuning_figure(self.activity, self.tuning))
        save_figure(Path(folder) / "ablation.png", ablation_figure(FRACTIONS, self.ablation))


def inspect(
    config: NetworkConfig,
    tensors: Tensors,
    flights: Flights,
    progress: Callable[[int, int, str], None] = lambda done, total, note: None,
) -> Inspection:
    """Run a network over flights, whole, with neurons removed and with manipulated inputs.

    Raises:
        ValueError: The network is not for the chip, or no attitude estimator, or the flights have another
            sample rate.
    """
    if config.controls:
        raise ValueError("the network is a controller, flights are for attitude estimators; leave out --data")
    if not np.isclose(flights.rate_hz, config.rate_hz):
        raise ValueError(f"the network is for {config.rate_hz:g} Hz, the flights have {flights.rate_hz:g} Hz")
    core = OnLoihi(config, tensors)
    progress(0, 3, "activity")
    activity = record(core, flights.gyro, flights.accel)
    progress(1, 3, "ablation")
    curves = {
        by: ablation(config, tensors, importance(tensors, activity, by), FRACTIONS, flights)
        for by in CRITERIA
    }
    progress(2, 3, "inputs")
    answers = responses(NetworkEstimator(Spiking(config, tensors), config.rate_hz), flights)
    tuning = tuning_curves(activity, flights)
    progress(3, 3, "done")
    energy = costs(counts(core, activity))
    return Inspection(config, core, activity, energy, answers, tuning, curves, flights.truth[0])


@matplotlib.rc_context(STYLE)
def raster_figure(activity: Activity, truth: Array, rate_hz: float, start_s: float = 10.0) -> Figure:
    """Spikes of both layers over some seconds of the first flight, busiest neurons on top; attitude above."""
    steps = activity.spikes.shape[1]
    length = min(round(RASTER_S * rate_hz), steps)
    first = min(round(start_s * rate_hz), steps - length)
    window = slice(first, first + length)
    time = np.arange(steps)[window] / rate_hz
    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    top, *below = figure.subplots(3, 1, sharex=True, height_ratios=(1, 2.4, 2.4))
    shown, estimate = (np.degrees(each[window]) for each in (truth, activity.estimate[0]))
    for axis, (name, colour) in enumerate(zip(("roll", "pitch"), COLOURS, strict=False)):
        top.plot(time, shown[:, axis], color=colour, lw=0.9, label=name)
        top.plot(time, estimate[:, axis], color=colour, lw=0.9, ls=":", label=f"{name}, estimated")
    top.set(ylabel="[°]", xlim=(time[0], time[-1]))
    top.legend(ncols=4, fontsize=7, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0)
    for k, axes in enumerate(below):
        spikes = activity.of_layer(activity.spikes[0, window], k)
        order = np.argsort(activity.of_layer(activity.rates, k), kind="stable")
        step, neuron = np.nonzero(spikes[:, order])
        axes.plot(time[step], neuron, "|", ms=1.6, mew=0.5, color=COLOURS[k])
        axes.set(title=LAYERS[k], ylabel="neuron, by rate", ylim=(-1, spikes.shape[1]))
        axes.grid(False)
    below[-1].set_xlabel("time [s]")
    return figure


@matplotlib.rc_context(STYLE)
def ablation_figure(fractions: Sequence[float], curves: Mapping[str, Array]) -> Figure:
    """Error against the share of neurons removed (the paper's Fig. 7)."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes, share = figure.subplots(), 100 * np.asarray(fractions)
    styles = zip(COLOURS, ("-", "--", "-.", ":"), "os^D", strict=True)
    for (by, errors), (colour, dash, marker) in zip(curves.items(), styles, strict=True):
        label = "at random" if by == "random" else f"by {by}"
        axes.plot(share, errors, color=colour, ls=dash, marker=marker, ms=5, mec="white", lw=1.8, label=label)
    bound = 1.02 * next(iter(curves.values()))[0]
    axes.axhline(bound, color="#111111", lw=0.8, ls=":", label="2 % more")
    axes.set(xlabel="neurons removed [%]", ylabel="mean absolute error [°]", yscale="log")
    axes.set_xlim(0, share.max())
    axes.set_yticks([2, 3, 5, 10, 20], ["2", "3", "5", "10", "20"])
    axes.minorticks_off()
    axes.legend(frameon=False)
    return figure


@matplotlib.rc_context(STYLE)
def tuning_figure(activity: Activity, curves: Mapping[str, TuningCurves]) -> Figure:
    """Rates of the hidden neurons against roll, pitch and their rates, sorted by what they follow."""
    best = activity.of_layer(preferred(dict(curves)), 1)
    figure = Figure(figsize=(7.4, 4.2), layout="constrained")
    panels = figure.subplots(1, len(curves), sharey=True)
    rates = {name: activity.of_layer(each.rates.T, 1).T for name, each in curves.items()}
    awake = np.flatnonzero(activity.of_layer(activity.rates, 1) > 1e-3)
    peak = [np.argmax(each, axis=1) for each in rates.values()]
    order = sorted(awake, key=lambda i: (best[i], peak[best[i]][i]))
    for k, (axes, (name, curve)) in enumerate(zip(panels, curves.items(), strict=True)):
        shown = rates[name][order] - np.nanmean(rates[name][order], axis=1, keepdims=True)
        shown /= np.maximum(np.nanmax(np.abs(shown), axis=1, keepdims=True, initial=0.0), 0.02)
        axes.imshow(shown, aspect="auto", cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
        ticks = [0, len(curve.centres) // 2, len(curve.centres) - 1]
        axes.set_xticks(ticks, [f"{round(curve.centres[i])}" for i in ticks])
        own = [place for place, i in enumerate(order) if best[i] == k]
        if own:
            axes.plot([-0.5, -0.5], [own[0] - 0.5, own[-1] + 0.5], color="#111111", lw=5, clip_on=False)
        unit = "°/s" if "rate" in name else "°"
        axes.set(title=name, xlabel=f"[{unit}]", ylabel="hidden neuron" if k == 0 else "")
        axes.grid(False)
    figure.colorbar(panels[0].images[0], ax=panels, label="rate, over its mean and range", shrink=0.8)
    return figure
