"""The inner life of a spiking network: what its neurons do, which of them matter, and a page of it."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.files import save_figure, write_whole

from ..evaluation.flights import Flights
from ..networks.decay_profiles import share_profiles
from ..networks.network import NetworkEstimator, OnLoihi, Spiking
from ..networks.weights_file import NetworkConfig, Tensors, load_network, shipped_network
from . import inspection_figures as figures
from .ablation import CRITERIA, ablation, importance
from .activity import Activity, record
from .encoding_study import StimulusResponse, TuningCurves, preferred, responses, tuning_curves
from .energy import Cost, costs, counts

FRACTIONS = tuple(np.round(np.arange(0.0, 0.65, 0.05), 2))
"""Shares of the neurons that the ablation curve removes."""
SILENT = 1e-4
"""Spikes per step below which a neuron counts as silent."""


@dataclass(frozen=True)
class Inspection:
    """A network over recorded flights."""

    name: str
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

    @property
    def silent(self) -> tuple[int, int]:
        """Neurons of the encoding and of the hidden layer that hardly ever spike."""
        first, second = (int((self.layer_rates(k) < SILENT).sum()) for k in (0, 1))
        return first, second

    def layer_rates(self, layer: int) -> NDArray[np.float64]:
        """Spikes per step of the neurons of a layer."""
        return self.activity.of_layer(self.activity.rates, layer)

    def summary(self) -> list[tuple[str, str]]:
        """What a terminal shows."""
        parts = [("network", f"{self.name}: {self.config.encoding} + {self.config.hidden} neurons")]
        for k, layer in enumerate(("encoding", "hidden")):
            rates = self.layer_rates(k)
            parts.append(
                (f"{layer} layer", f"{rates.mean():.3f} spikes per neuron and step, {self.silent[k]} silent, "
                 f"{int((rates > 0.9).sum())} almost always on")
            )  # fmt: skip
        parts += [(f"error, {name}", f"{each.error_deg:.2f}°") for name, each in self.responses.items()]
        best = preferred(self.tuning)
        for k, layer in enumerate(("encoding", "hidden")):
            found = np.bincount(self.activity.of_layer(best, k), minlength=len(self.tuning))
            said = ", ".join(f"{name} {count}" for name, count in zip(self.tuning, found, strict=True))
            parts.append((f"{layer} neurons follow most", said))
        for by, errors in self.ablation.items():
            if by == "random":
                continue
            within = [f for f, error in zip(FRACTIONS, errors, strict=True) if error < 1.02 * errors[0]]
            parts.append(
                (f"removed by {by} for < 2 %", f"{100 * max(within):.0f} % of the neurons, untrained")
            )
        energy = sum(line.nanojoules for line in self.costs)
        parts.append(("modelled dynamic energy", f"{energy:.0f} nJ a step, {self.costs[0].count:.0f} events"))
        return parts


def load_spiking(
    weights: str | Path | None = None, profiles: int | None = None
) -> tuple[str, NetworkConfig, Tensors]:
    """A network for the chip, with fewer decay profiles where asked, and what to call it.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not weights of an Att-SNN.
    """
    config, tensors = shipped_network("att-snn") if weights is None else load_network(weights)
    if config.model != "att-snn":
        raise ValueError(f"{weights}: weights of {config.model}, should be of att-snn")
    if profiles is not None:
        tensors = share_profiles(tensors, profiles)
    return "att-snn" if weights is None else str(weights), config, tensors


def inspect(
    name: str,
    config: NetworkConfig,
    tensors: Tensors,
    flights: Flights,
    progress: Callable[[int, int, str], None] = lambda done, total, note: None,
) -> Inspection:
    """Run a network over flights in every way that the page shows.

    Raises:
        ValueError: The network is not for the chip, or no attitude estimator, or the flights have another
            sample rate.
    """
    if config.controls:
        raise ValueError(f"{name} is a controller, flights are for attitude estimators; leave out --data")
    if not np.isclose(flights.rate_hz, config.rate_hz):
        raise ValueError(f"{name} is for {config.rate_hz:g} Hz, the flights have {flights.rate_hz:g} Hz")
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
    return Inspection(name, config, core, activity, energy, answers, tuning, curves, flights.truth[0])


def write_page(out: str | Path, found: Inspection) -> Path:
    """Draw everything into a folder, with a page of it; the page's path."""
    out = Path(out)
    activity, rate = found.activity, found.config.rate_hz * found.config.steps_per_sample
    drawn = {
        "rates": ("How often neurons spike", figures.rate_histograms(activity)),
        "raster": ("Spikes of the first flight", figures.raster(activity, found.truth, rate)),
        "membranes": ("Membrane potentials", figures.membranes(activity, rate)),
        "ablation": ("Error against neurons removed", figures.ablation_curve(FRACTIONS, found.ablation)),
        "inputs": (
            "Manipulated inputs",
            figures.manipulated(found.responses, found.truth, found.config.rate_hz),
        ),
        "tuning": ("What neurons encode", figures.tuning(activity, found.tuning)),
    }
    sections = []
    for key, (title, figure) in drawn.items():
        image = base64.b64encode(save_figure(out / f"{key}.png", figure, dpi=130).read_bytes()).decode()
        sections.append(f'<h2>{title}</h2><img alt="{title}" src="data:image/png;base64,{image}">')
    energy = [
        (
            each.operation,
            *(f"{x:.4g}" for x in (each.count, each.picojoules, each.nanojoules, 100 * each.share)),
        )
        for each in found.costs
    ]
    body = [
        f"<h1>Inside {html.escape(found.name)}</h1>",
        _table(("", ""), found.summary()),
        "<h2>Modelled dynamic energy of a step</h2>",
        _table(("operation", "per step", "pJ each", "nJ", "share, %"), energy),
        *sections,
    ]
    return write_whole(out / "inspection.html", PAGE.format(body="\n".join(body)))


PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Inside a spiking network</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }}
img {{ max-width: 100% }} table {{ border-collapse: collapse }} th {{ text-align: left }}
td, th {{ padding: 0.15rem 1rem 0.15rem 0; border-bottom: 1px solid #ddd }}
</style>
{body}
</html>
"""


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = [("th", header)] * any(header) + [("td", row) for row in rows]
    lines = ["".join(f"<{tag}>{html.escape(each)}</{tag}>" for each in row) for tag, row in cells]
    return "\n".join(["<table>", *(f"<tr>{line}</tr>" for line in lines), "</table>"])
