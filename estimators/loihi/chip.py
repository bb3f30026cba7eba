"""Where a network's neurons go on a Loihi chip, and whether they fit.

A chip has 128 cores. The limits of one: 1024 compartments, 128 KiB of synaptic memory, 4096 fan-in and 4096
fan-out axons (Davies et al. 2018); 32 decay profiles, 16 thresholds and 16 synaptic formats, one for each
exponent of weights (registers, as in nengo-loihi).

A neuron with an after-spike current takes a second compartment, whose membrane is not used. A decay that a
compartment does not use, that or the current's of one that no spike enters, may be any: compartments that use
one decay each share a profile.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .neurons import VTH_MAX, WEIGHT_EXP_MIN, LoihiLayer

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
"""A decay that a compartment does not use."""


@dataclass(frozen=True)
class Neuron:
    """What a neuron takes on a core."""

    profiles: frozenset[tuple[int, int]]
    """(du, dv) of each of its compartments."""
    thresholds: frozenset[int]
    """Mantissas of theirs."""
    compartments: int
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
            self.profiles | neuron.profiles,
            self.thresholds | neuron.thresholds,
            self.compartments + neuron.compartments,
        )
        core.synapses = self.synapses.copy()
        np.add.at(core.synapses, neuron.synapses, 1)
        return core


def distinct_profiles(profiles: Iterable[tuple[int, int]]) -> int:
    """Fewest decay profiles that serve these (du, dv), where `ANY` stands for a decay that is not used."""
    every = set(profiles)
    whole = {each for each in every if ANY not in each}
    currents = {du for du, dv in every if dv == ANY} - {du for du, _ in whole}
    membranes = {dv for du, dv in every if du == ANY} - {dv for _, dv in whole}
    return len(whole) + max(len(currents), len(membranes))


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
        neurons, profiles = _neurons(layer, int(starts[k])), decay_profiles(layer)
        for neuron in np.lexsort(profiles.T):
            i = int(neuron)
            grown = core.with_neuron(k, i, neurons[i])
            if excess(grown):
                alone = ChipCore(sources).with_neuron(k, i, neurons[i])
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
    """(du, dv) of the somas of a layer, (out, 2); du is `ANY` where no spike enters the layer."""
    driven = np.asarray(layer.w_in).shape[1] > 0 or layer.w_rec is not None
    du = np.asarray(layer.du) if driven else np.full_like(np.asarray(layer.dv), ANY)
    return np.stack([du, np.asarray(layer.dv)], axis=1)


def _starts(layers: Sequence[LoihiLayer]) -> Ints:
    """First source of each layer, as in the emulator: the network's input comes first."""
    widths = [np.asarray(layers[0].w_in).shape[1], *(np.asarray(layer.w_in).shape[0] for layer in layers)]
    return np.cumsum(widths)


def _neurons(layer: LoihiLayer, start: int) -> list[Neuron]:
    """What each neuron of a layer takes; `start` is the source that the first of them is."""
    after, d_after = np.asarray(layer.w_after) != 0, np.asarray(layer.d_after)
    vth, own_format = np.asarray(layer.vth), -np.asarray(layer.exp_after)
    neurons = []
    for i, ((du, dv), (formats, sources)) in enumerate(
        zip(decay_profiles(layer), _fan_in(layer, start), strict=True)
    ):
        profiles, thresholds = {(int(du), int(dv))}, {int(vth[i])}
        if after[i]:
            profiles.add((int(d_after[i]), ANY))
            thresholds.add(VTH_MAX)
            formats, sources = np.append(formats, own_format[i]), np.append(sources, start + i)
        compartments = 1 + int(after[i])
        neurons.append(Neuron(frozenset(profiles), frozenset(thresholds), compartments, (formats, sources)))
    return neurons


def _fan_in(layer: LoihiLayer, start: int) -> list[tuple[Ints, Ints]]:
    """Formats, counted by -exponent, and sources of the synapses of the soma of each neuron of a layer."""
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
