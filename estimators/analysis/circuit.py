"""Error, spikes and modelled energy of a circuit on recorded flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quadsim.dataset.reading import open_dataset

from ..circuit.circuit_estimator import circuit_estimator
from ..circuit.circuit_records import ANGLE_DIGITS, EVENTS, RINGS, Circuit
from ..circuit.file import CircuitConfig
from ..circuit.on_chip import populations
from ..circuit.parameters import RATE_HZ, Parameters, quantised
from ..evaluation.flights import Flights, load_flights
from ..metrics import absolute_error
from .energy import costs


@dataclass(frozen=True)
class Measured:
    """Measurements of a circuit on recorded flights."""

    error_deg: float
    """Mean absolute error of roll and pitch from an unknown initial attitude [deg]."""
    spikes: dict[str, float]
    """Spike rate of each kind of neuron [1/s]."""
    synaptic_events: float
    """Synaptic events per step."""
    nanojoules: float
    """Modelled dynamic energy of a step [nJ] (Davies et al. 2018; see `estimators.analysis.energy`)."""

    def summary(self) -> list[tuple[str, str]]:
        """Return names and values for the terminal."""
        return [
            *((f"spikes of {kind}", f"{rate:,.0f} /s") for kind, rate in self.spikes.items()),
            ("all spikes", f"{sum(self.spikes.values()):,.0f} /s"),
            ("synaptic events", f"{self.synaptic_events:.0f} per step"),
            ("modelled dynamic energy", f"{self.nanojoules:.0f} nJ per step"),
            ("error", f"{self.error_deg:.2f}°"),
        ]


def measure_datasets(config: CircuitConfig, p: Parameters, data: Sequence[str | Path]) -> Measured:
    """Run a spiking circuit on the flights of datasets."""
    return measure_circuit(config, p, load_flights([open_dataset(path) for path in data]))


def measure_circuit(config: CircuitConfig, p: Parameters, flights: Flights) -> Measured:
    """Run a spiking circuit on flights."""
    estimator = circuit_estimator("att-snn", p, config.steps_per_sample, flights.rate_hz)
    estimator.reset(len(flights.gyro))
    error = absolute_error(estimator.sequence(flights.gyro, flights.accel), flights.truth)
    steps = flights.gyro.shape[0] * flights.gyro.shape[1] * config.steps_per_sample
    counts = estimator.states["events"].sum(0, dtype=np.int64)
    circuit = quantised(p, config.steps_per_sample)
    compartments = sum(each.compartments for each in populations(circuit))
    events = synaptic_events(circuit, dict(zip(EVENTS, counts / steps, strict=True)))
    spikes = float(counts.sum()) / steps + len(RINGS)
    rates = (counts / steps * config.steps_per_sample * RATE_HZ).tolist()
    operations = {
        "synaptic event": events,
        "active neuron update": spikes,
        "inactive neuron update": compartments - spikes,
        "spike within a tile": spikes,
        "hop between tiles": 0.0,
    }
    energy = sum(each.nanojoules for each in costs(operations))
    by_kind: dict[str, float] = dict(zip(EVENTS, rates, strict=True))
    return Measured(float(np.nanmean(error)), by_kind, events, energy)


def synaptic_events(circuit: Circuit, spikes: dict[str, float]) -> float:
    """Return the number of synaptic events for given spikes of each kind, including those of the rings."""
    vectors, gates, felt = len(circuit.start), len(circuit.gate), 18
    reached = {
        "angles": 4 * vectors + 2,
        "forces": vectors + gates + 4,
        "vectors": vectors + gates + 4 * ANGLE_DIGITS + 4 * len(circuit.learn) / vectors,
        "coincidences": 3,
        "innovations": vectors + 4 * len(circuit.learn) / gates,
        "gates": 0,
        "felt": gates,
        "bias": 0,
        "learning": 1,
    }
    rings = len(RINGS) * (gates + felt + 1)
    return rings + sum(reached[kind] * count for kind, count in spikes.items())
