"""Where a network's neurons go on a Loihi chip, and whether they fit.

A chip has 128 cores. The limits of one: 1024 compartments, 128 KiB of synaptic memory, 4096 fan-in and 4096
fan-out axons (Davies et al. 2018); 32 decay profiles, 16 thresholds and 16 synaptic formats, one for each
exponent of weights (registers, as in nengo-loihi).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .neurons import DECAY_ONE, WEIGHT_EXP_MIN, LoihiLayer

Ints = NDArray[np.int64]

CORES = 128
LIMITS = {
    "compartments": 1024,
    "profiles": 32,
    "thresholds": 16,
    "synaptic formats": 16,
    "fan-in axons": 4096,
    "fan-out axons": 4096,
    "synaptic bits": 128 * 1024 * 8,
}
"""What one core holds."""
_WEIGHT_BITS, _HEADER_BITS, _BLOCK, _WORD_BITS = 8, 10, 64, 64
_INDEX_BITS = (6, 7, 8, 9, 10)


@dataclass
class ChipCore:
    """The neurons of one core.

    Args:
        sources: Number of sources of spikes in the whole network.
    """

    sources: int
    neurons: dict[int, list[int]] = field(default_factory=dict)
    """Layer to the neurons of that layer."""
    profiles: set[tuple[int, int]] = field(default_factory=set)
    """Distinct (du, dv)."""
    thresholds: set[int] = field(default_factory=set)
    fan_out: int = 0
    """Axons to other cores or to itself."""

    def __post_init__(self) -> None:
        """Start without synapses."""
        self.synapses = np.zeros((1 - WEIGHT_EXP_MIN, self.sources), np.int64)
        """Synapses of each source on this core, a row for each exponent of weights, from 0 down."""

    def used(self) -> dict[str, int]:
        """How much of each limit is used."""
        count = sum(map(len, self.neurons.values()))
        return {
            "compartments": count,
            "profiles": len(self.profiles),
            "thresholds": len(self.thresholds),
            "synaptic formats": int(np.count_nonzero(self.synapses.any(1))),
            "fan-in axons": int(np.count_nonzero(self.synapses.any(0))),
            "fan-out axons": self.fan_out,
            "synaptic bits": sum(synaptic_bits(each, count) for each in self.synapses),
        }

    def with_neuron(
        self, layer: int, neuron: int, profile: tuple[int, int], vth: int, inputs: tuple[Ints, Ints]
    ) -> ChipCore:
        """A core that holds one neuron more, whose synapses are at these rows and columns of `synapses`."""
        neurons = {**self.neurons, layer: [*self.neurons.get(layer, ()), neuron]}
        core = ChipCore(self.sources, neurons, self.profiles | {profile}, self.thresholds | {vth})
        core.synapses = self.synapses.copy()
        core.synapses[inputs] += 1
        return core


def synaptic_bits(synapses: Ints, compartments: int) -> int:
    """Memory of a core's synapses of one format, stored as lists of weight and target for each fan-in axon.

    A weight takes 8 bits, its target 6 to 10; a list is cut into blocks of 64 with a head of 10 bits, padded
    to words of 64 bits.

    Args:
        synapses: Number of synapses of each axon, (axons,).
        compartments: Neurons on the core.
    """
    needed = max(compartments - 1, 0).bit_length()
    each = _WEIGHT_BITS + next((bits for bits in _INDEX_BITS if bits >= needed), _INDEX_BITS[-1])
    whole, rest = np.divmod(synapses, _BLOCK)

    def words(count: Ints | int) -> Ints:
        return -(-(np.asarray(count) * each + _HEADER_BITS) // _WORD_BITS)

    return int(_WORD_BITS * np.sum(whole * words(_BLOCK) + np.where(rest > 0, words(rest), 0)))


def excess(core: ChipCore) -> list[str]:
    """Every limit of a core that is exceeded, and by how much; empty where it fits."""
    return [
        f"{used} {name}, a core has {LIMITS[name]}: {used - LIMITS[name]} too many"
        for name, used in core.used().items()
        if used > LIMITS[name]
    ]


def partition(layers: Sequence[LoihiLayer]) -> list[ChipCore]:
    """Place a network: layer after layer, neurons of one profile together, a new core when the last is full.

    Args:
        layers: From the input to the output.

    Returns:
        The cores in use.

    Raises:
        ValueError: A limit of a core or of the chip is exceeded; the message says which, and by how much.
    """
    starts = _starts(layers)
    sources = int(starts[-1])
    core, cores = ChipCore(sources), []
    for k, layer in enumerate(layers):
        fan_in, profiles, vth = _fan_in(layer, int(starts[k])), decay_profiles(layer), np.asarray(layer.vth)
        for neuron in np.lexsort(profiles.T):
            i = int(neuron)
            profile = int(profiles[i, 0]), int(profiles[i, 1])
            grown = core.with_neuron(k, i, profile, int(vth[i]), fan_in[i])
            if excess(grown):
                alone = ChipCore(sources).with_neuron(k, i, profile, int(vth[i]), fan_in[i])
                if wrong := excess(alone):
                    raise ValueError(f"neuron {i} of layer {k}: {wrong[0]}")
                cores.append(core)
                grown = alone
            core = grown
    cores.append(core)
    if len(cores) > CORES:
        raise ValueError(
            f"the network needs {len(cores)} cores, a chip has {CORES}: {len(cores) - CORES} too many"
        )
    _count_fan_out(cores, starts)
    for number, placed in enumerate(cores):
        if wrong := excess(placed):
            raise ValueError(f"core {number}: {wrong[0]}")
    return cores


def decay_profiles(layer: LoihiLayer) -> Ints:
    """(du, dv) of each neuron, (out, 2); du of a layer that no spike enters is free, and stands at 4096."""
    driven = np.asarray(layer.w_in).shape[1] > 0 or layer.w_rec is not None
    du = np.asarray(layer.du) if driven else np.full_like(np.asarray(layer.dv), DECAY_ONE)
    return np.stack([du, np.asarray(layer.dv)], axis=1)


def _starts(layers: Sequence[LoihiLayer]) -> Ints:
    """First source of each layer, as in the emulator: the network's input comes first."""
    widths = [np.asarray(layers[0].w_in).shape[1], *(np.asarray(layer.w_in).shape[0] for layer in layers)]
    return np.cumsum(widths)


def _fan_in(layer: LoihiLayer, start: int) -> list[tuple[Ints, Ints]]:
    """Formats, counted by -exponent, and sources of the synapses of each neuron of a layer."""
    w_in = np.asarray(layer.w_in)
    weights = w_in if layer.w_rec is None else np.concatenate([w_in, np.asarray(layer.w_rec)], axis=1)
    formats = -np.stack([np.asarray(layer.exp_in), np.asarray(layer.exp_rec)], 1)
    sources = [np.flatnonzero(row) for row in weights]
    return [
        (of_neuron[(found >= w_in.shape[1]).astype(int)], start - w_in.shape[1] + found)
        for of_neuron, found in zip(formats, sources, strict=True)
    ]


def _count_fan_out(cores: Sequence[ChipCore], starts: Ints) -> None:
    """Axons of each core: one for every neuron and every core that the neuron has synapses on."""
    reached = np.sum([core.synapses.any(0) for core in cores], axis=0)
    for core in cores:
        core.fan_out = sum(int(reached[starts[k] + np.array(each)].sum()) for k, each in core.neurons.items())
