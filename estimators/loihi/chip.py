"""Where a network's neurons go on a Loihi chip, and whether they fit.

A chip has 128 cores. The limits of one: 1024 compartments, 128 KiB of synaptic memory, 4096 fan-in and 4096
fan-out axons (Davies et al. 2018); 32 decay profiles, 16 thresholds and 16 synaptic formats, one for each
exponent of weights (registers, as in nengo-loihi).

A neuron takes a compartment. The current's decay of one that no spike enters may be any: it shares a profile
with any neuron of its membrane's decay.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .layers import WEIGHT_EXP_MIN, LoihiLayer

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
ANY = -1
"""A current's decay that a compartment does not use."""


class Neuron(NamedTuple):
    """What a neuron takes on a core."""

    profile: tuple[int, int]
    """(du, dv)."""
    threshold: int
    """Its mantissa."""
    synapses: tuple[Ints, Ints]
    """Formats, counted by -exponent, and sources of the spikes that enter it."""


@dataclass
class ChipCore:
    """The neurons of one core.

    Args:
        sources: Number of sources of spikes in the whole network.
    """

    sources: int
    neurons: dict[int, list[int]] = field(default_factory=dict)
    """Layer to the neurons of that layer."""
    profiles: frozenset[tuple[int, int]] = frozenset()
    """Distinct (du, dv)."""
    thresholds: frozenset[int] = frozenset()
    compartments: int = 0
    fan_out: int = 0
    """Axons to other cores or to itself."""

    def __post_init__(self) -> None:
        """Start without synapses."""
        self.synapses = np.zeros((1 - WEIGHT_EXP_MIN, self.sources), np.int64)
        """Synapses of each source on this core, a row for each exponent of weights, from 0 down."""

    def used(self) -> dict[str, int]:
        """How much of each limit is used."""
        return {
            "compartments": self.compartments,
            "profiles": distinct_profiles(self.profiles),
            "thresholds": len(self.thresholds),
            "synaptic formats": int(np.count_nonzero(self.synapses.any(1))),
            "fan-in axons": int(np.count_nonzero(self.synapses.any(0))),
            "fan-out axons": self.fan_out,
            "synaptic bits": sum(synaptic_bits(each, self.compartments) for each in self.synapses),
        }

    def with_neuron(self, layer: int, number: int, neuron: Neuron) -> ChipCore:
        """A core that holds one neuron more."""
        core = ChipCore(
            self.sources,
            {**self.neurons, layer: [*self.neurons.get(layer, ()), number]},
            self.profiles | {neuron.profile},
            self.thresholds | {neuron.threshold},
            self.compartments + 1,
        )
        core.synapses = self.synapses.copy()
        np.add.at(core.synapses, neuron.synapses, 1)
        return core


def distinct_profiles(profiles: Iterable[tuple[int, int]]) -> int:
    """Fewest decay profiles that serve these (du, dv); `ANY`: a current's decay that is not used."""
    every = set(profiles)
    whole = {each for each in every if ANY not in each}
    return len(whole) + len({dv for du, dv in every if du == ANY} - {dv for _, dv in whole})


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


def excess(core: ChipCore) -> str:
    """The first limit of a core that is exceeded, and by how much; empty where it fits."""
    for name, used in core.used().items():
        if used > LIMITS[name]:
            return f"{used} {name}, a core has {LIMITS[name]}: {used - LIMITS[name]} too many"
    return ""


def partition(layers: Sequence[LoihiLayer]) -> list[ChipCore]:
    """Place a network: layer after layer, neurons of one profile together, a new core when the last is full.

    Args:
        layers: From the input to the output.

    Returns:
        The cores in use.

    Raises:
        ValueError: A limit of a core or of the chip is exceeded; the message says which, and by how much.
    """
    # sources of spikes as in the emulator: the network's input comes first
    starts = np.cumsum([layers[0].w_in.shape[1], *(len(layer.w_in) for layer in layers)])
    sources = int(starts[-1])
    cores = [ChipCore(sources)]
    for k, layer in enumerate(layers):
        neurons = _neurons(layer, int(starts[k]))
        for i in map(int, np.lexsort(decay_profiles(layer).T)):
            grown = cores[-1].with_neuron(k, i, neurons[i])
            if not excess(grown):
                cores[-1] = grown
                continue
            cores.append(ChipCore(sources).with_neuron(k, i, neurons[i]))
            if wrong := excess(cores[-1]):
                raise ValueError(f"neuron {i} of layer {k}: {wrong}")
    if len(cores) > CORES:
        raise ValueError(
            f"the network needs {len(cores)} cores, a chip has {CORES}: {len(cores) - CORES} too many"
        )
    reached = np.sum([core.synapses.any(0) for core in cores], axis=0)
    for number, core in enumerate(cores):
        core.fan_out = sum(int(reached[starts[k] + np.array(each)].sum()) for k, each in core.neurons.items())
        if wrong := excess(core):
            raise ValueError(f"core {number}: {wrong}")
    return cores


def decay_profiles(layer: LoihiLayer) -> Ints:
    """(du, dv) of the somas of a layer, (out, 2); du is `ANY` where no spike enters the layer."""
    dv = layer.dv
    driven = layer.w_in.shape[1] > 0 or layer.w_rec is not None
    return np.stack([layer.du if driven else np.full_like(dv, ANY), dv], axis=1)


def _neurons(layer: LoihiLayer, start: int) -> list[Neuron]:
    """What each neuron of a layer takes; `start` is the source that the first of them is."""
    w_rec = np.zeros((len(layer.w_in), 0)) if layer.w_rec is None else layer.w_rec
    formats = -np.stack([layer.exp_in, layer.exp_rec], 1)
    neurons = []
    for i, (du, dv) in enumerate(decay_profiles(layer)):
        below = np.flatnonzero(layer.w_in[i]) + start - layer.w_in.shape[1]
        entering = [below, np.flatnonzero(w_rec[i]) + start]
        synapses = np.repeat(formats[i], list(map(len, entering))), np.concatenate(entering)
        neurons.append(Neuron((int(du), int(dv)), int(layer.vth[i]), synapses))
    return neurons
