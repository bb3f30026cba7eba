"""The inner life of a spiking network: what its neurons do, what they encode, and which of them matter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.files import save_figure

from ..evaluation.flights import Flights
from ..networks.network import NetworkEstimator, Spiking
from ..networks.on_chip import OnLoihi
from ..networks.weights_file import NetworkConfig, Tensors
from .ablation import CRITERIA, ablation, importance
from .activity import LAYERS, Activity, record
from .encoding_study import StimulusResponse, TuningCurves, preferred, responses, tuning_curves
from .energy import Cost, costs, counts
from .inspection_figures import ablation_figure, raster_figure, tuning_figure

FRACTIONS = tuple(np.round(np.arange(0.0, 0.65, 0.05), 2))
"""Shares of the neurons that the ablation curve removes."""
SILENT = 1e-4
"""Spikes per step below which a neuron counts as silent."""


@dataclass(frozen=True)
class Inspection:
    """A network over recorded flights."""

    config: NetworkConfig
    core: OnLoihi
    activity: Activity
    costs: list[Cost]
    responses: dict[str, StimulusResponse]
    tuning: dict[str, TuningCurves]
    ablation: dict[str, NDArray[np.float64]]
    """Criterion to the error at each of FRACTIONS [deg]."""
    truth: NDArray[np.float64]
    """Of the first flight (T, 2) [rad]."""

    def layer_rates(self, layer: int) -> NDArray[np.float64]:
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
        rate_hz = self.config.rate_hz * self.config.steps_per_sample
        save_figure(Path(folder) / "raster.png", raster_figure(self.activity, self.truth, rate_hz))
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
