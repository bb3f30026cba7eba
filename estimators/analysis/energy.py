"""Costs of an update: operations counted on flights, and energy modelled from them.

The energies of the chip are those of Davies et al. 2018, which were simulated before the chip existed. They
are a lower bound: dynamic energy only, without leakage. The host, which scales the readings and drives the
encoding layer, is counted separately. Neither value is a measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..evaluation.flights import Flights
from ..loihi.chip import ChipCore
from ..metrics import attitude_error
from ..networks.forward import OnLoihi
from ..networks.weights_file import NetworkConfig
from .activity import Activity, record

PICOJOULES = {
    "synaptic event": 23.6,
    "active neuron update": 81.0,
    "inactive neuron update": 52.0,
    "spike within a tile": 1.7,
    "hop between tiles": 3.5,
}
"""Energy of one operation [pJ]; a hop costs 3.0 pJ east-west and 4.0 pJ north-south."""
HOST_PICOJOULES = {"multiplication": 3.1, "addition": 0.1}
"""Energy of one operation on 32-bit integers in 45 nm [pJ] (Horowitz, ISSCC 2014), without fetching and
decoding the instruction, which takes about 70 pJ."""
FLOAT_PICOJOULES = 2.3
"""Energy of an operation on 32-bit floats in 45 nm [pJ] (Horowitz, ISSCC 2014): the mean of an addition (0.9
pJ) and a multiplication (3.7 pJ)."""
CORES_PER_TILE = 4
PAPER_MEASURED = {"µJ": 13.2, "µs": 10.0}
"""Energy and time of a step of the recurrent layer alone, as measured by the paper on a board of 32 chips."""


def host_operations(config: NetworkConfig) -> dict[str, int]:
    """Count the host's multiplications, each with an addition, for one sample (`encode_sample` and `drive`).

    Each of six readings and each set-point of a controller takes a subtraction and a multiplication. The
    current of each encoding neuron takes a product and an addition for each input and for its decay.
    Comparisons and shifts are not counted.
    """
    inputs = config.n_inputs
    return {"scaled readings": inputs, "currents of the encoding layer": (inputs + 1) * config.encoding}


@dataclass(frozen=True)
class EnergyTerm:
    """One line of the energy model."""

    operation: str
    count: float
    """Number of operations per step."""
    picojoules: float
    """Energy of one operation [pJ]."""
    share: float
    """Share of the modelled energy. If the coefficient is wrong by x %, the total is wrong by share times x
    %."""

    @property
    def nanojoules(self) -> float:
        """Energy of these operations per step [nJ]."""
        return self.count * self.picojoules / 1e3


def counts(cores: Sequence[ChipCore], activity: Activity) -> dict[str, float]:
    """Count operations per step on the chip, averaged over the flights.

    A spike causes one synaptic event for each of its synapses and one message to each core that holds such a
    synapse. Weights of zero are not stored. Messages travel between tiles of four cores in a row; messages of
    inputs start at the first tile.
    """
    spikes = activity.spikes.sum(axis=(0, 1)) / activity.steps
    updates = float(sum(placed.used()["compartments"] for placed in cores))
    active = float(activity.active.sum() / activity.steps)
    fan_out = synapses(cores, spikes.size)
    edges = spikes.size - sum(activity.sizes) + np.cumsum((0, *activity.sizes))
    home = np.zeros(edges[-1], np.int64)
    for number, placed in enumerate(cores):
        for layer, ids in placed.neurons.items():
            home[edges[layer] + np.array(ids)] = number
    tile = np.arange(len(cores)) // CORES_PER_TILE
    distance = np.abs(tile[home][:, None] - tile[None, :])  # (neurons, cores)
    reached = fan_out > 0
    return {
        "synaptic event": float(spikes @ fan_out.sum(axis=1)),
        "active neuron update": active,
        "inactive neuron update": updates - active,
        "spike within a tile": float(spikes @ reached.sum(axis=1)),
        "hop between tiles": float(spikes @ (reached * distance).sum(axis=1)),
    }


def synapses(cores: Sequence[ChipCore], neurons: int) -> NDArray[np.int64]:
    """Count the synapses of each neuron and spiking input on each core, (neurons, cores)."""
    return np.stack([core.synapses.sum(0)[-neurons:] for core in cores], axis=1)


def costs(counted: dict[str, float]) -> list[EnergyTerm]:
    """Return the lines of the energy model."""
    total = sum(counted[name] * each for name, each in PICOJOULES.items())
    return [
        EnergyTerm(name, counted[name], each, counted[name] * each / total)
        for name, each in PICOJOULES.items()
    ]


def chip_summary(config: NetworkConfig, core: OnLoihi, flights: Flights) -> dict[str, str]:
    """Summarise a network on the chip over flights for the terminal: spikes, operations, energy, error.

    Raises:
        ValueError: The network is a controller, or its sample rate differs from that of the flights.
    """
    if config.controls:
        raise ValueError("the network is a controller, flights are for attitude estimators; leave out --data")
    if not np.isclose(flights.rate_hz, config.rate_hz):
        raise ValueError(f"the network is for {config.rate_hz:g} Hz, the flights have {flights.rate_hz:g} Hz")
    activity = record(core, flights.gyro, flights.accel)
    rates = {name: activity.of_layer(activity.rates, k) for k, name in enumerate(("encoding", "hidden"))}
    lines = costs(counts(core.cores, activity))
    found = {
        f"{name} layer": f"{each.mean():.3f} spikes per neuron and step, {(each == 0).sum()} silent"
        for name, each in rates.items()
    }
    found |= {f"{each.operation}, a step": f"{each.count:.4g}" for each in lines}
    found["modelled dynamic energy"] = f"{sum(each.nanojoules for each in lines):.0f} nJ per step"
    return found | {"error": f"{attitude_error(activity.estimate, flights.truth).mean:.2f}°"}


def snn_flops(encoding: int, hidden: int, spikes: tuple[float, float], outputs: int = 2) -> dict[str, float]:
    """Count the floating-point operations of one update of the spiking network.

    The encoder multiplies six inputs. A spike adds one row of weights. Every neuron decays and adds twice and
    compares once; an output neuron does not compare. "dense" is the count without skipping zeros.

    Args:
        encoding: Neurons of the encoding layer.
        hidden: Neurons of the hidden layer.
        spikes: Mean spikes per step of both layers.
        outputs: Number of leaky integrators.
    """
    encoder = 2 * 6 * encoding
    neurons = 5 * (encoding + hidden) + 4 * outputs
    sparse = spikes[0] * hidden + spikes[1] * (hidden + outputs)
    dense = 2 * (encoding * hidden + hidden * hidden + hidden * outputs)
    return {"sparse": encoder + neurons + sparse, "dense": encoder + neurons + dense}


def gru_flops(encoding: int, hidden: int, outputs: int = 2) -> float:
    """Count the floating-point operations of one update of two GRU layers and a linear output.

    A layer of h units with m inputs takes 2 · 3h (m + h) operations for the products, 6h for the biases, 3h
    to join the parts and gate one of them, 3h for functions and 4h to mix. A function counts as one
    operation.
    """
    layers = ((6, encoding), (encoding, hidden))
    return float(sum(6 * h * (m + h) + 16 * h for m, h in layers) + (2 * hidden + 1) * outputs)
