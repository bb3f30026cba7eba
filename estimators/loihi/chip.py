"""Placement of a network's neurons on the cores of a Loihi chip.

A chip has 128 cores. The limits of one: 1024 compartments, 128 KiB of synaptic memory, 4096 fan-in and 4096
fan-out axons (Davies et al. 2018); 32 decay profiles, 16 thresholds and 16 synaptic formats, one for each
exponent of weights (registers, as in nengo-loihi).

A neuron takes one compartment. If no spikes enter a neuron, its current decay is arbitrary, so it can share a
profile with any neuron of the same membrane decay.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

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
"""Limits of one core."""
_WEIGHT_BITS, _HEADER_BITS, _BLOCK, _WORD_BITS = 8, 10, 64, 64
_INDEX_BITS = (6, 7, 8, 9, 10)
ANY = -1
"""Marks a current decay that a compartment does not use."""


@dataclass(frozen=True)
class ChipCore:
    """The neurons of one core."""

    neurons: dict[int, list[int]]
    """Neurons on the core, by layer."""
    profiles: int
    """Number of distinct decay profiles (du, dv)."""
    thresholds: int
    compartments: int
    synapses: Ints
    """Number of synapses of each source on this core, with a row per weight exponent, from 0 downwards."""
    fan_out: int = 0
    """Number of axons to other cores and to the same core."""

    def used(self) -> dict[str, int]:
        """Use of each limited resource."""
        return {
            "compartments": self.compartments,
            "profiles": self.profiles,
            "thresholds": self.thresholds,
            "synaptic formats": int(np.count_nonzero(self.synapses.any(1))),
            "fan-in axons": int(np.count_nonzero(self.synapses.any(0))),
            "fan-out axons": self.fan_out,
            "synaptic bits": sum(synaptic_bits(each, self.compartments) for each in self.synapses),
        }

    def excess(self) -> str:
        """The first exceeded limit, with its values; empty if the core fits."""
        for name, used in self.used().items():
            if used > LIMITS[name]:
                return f"{used} {name}, a core has {LIMITS[name]}: {used - LIMITS[name]} too many"
        return ""


def distinct_profiles(profiles: Iterable[tuple[int, int]]) -> int:
    """Return the smallest number of decay profiles for these (du, dv).

    `ANY` marks an unused current decay.
    """
    every = set(profiles)
    whole = {each for each in every if ANY not in each}
    return len(whole) + len({dv for du, dv in every if du == ANY} - {dv for _, dv in whole})


def synaptic_bits(synapses: Ints, compartments: int) -> int:
    """Return the memory of a core's synapses of one format, stored as a list per fan-in axon [bits].

    A weight takes 8 bits and a target 6 to 10 bits. A list is divided into blocks of 64 with a header of 10
    bits, padded to words of 64 bits.

    Args:
        synapses: Number of synapses of each axon, (axons,).
        compartments: Number of neurons on the core.
    """
    needed = max(compartments - 1, 0).bit_length()
    each = _WEIGHT_BITS + next((bits for bits in _INDEX_BITS if bits >= needed), _INDEX_BITS[-1])
    whole, rest = np.divmod(synapses, _BLOCK)

    def words(count: Ints | int) -> Ints:
        return -(-(np.asarray(count) * each + _HEADER_BITS) // _WORD_BITS)

    return int(_WORD_BITS * np.sum(whole * words(_BLOCK) + np.where(rest > 0, words(rest), 0)))


def partition(layers: Sequence[LoihiLayer]) -> list[ChipCore]:
    """Place a network on cores, layer by layer, with neurons of the same profile together.

    Args:
        layers: From the input to the output.

    Returns:
        The used cores.

    Raises:
        ValueError: A limit of a core or of the chip is exceeded; the message gives the limit and the values.
    """
    # sources of spikes as in the emulator: the network's input comes first
    edges = np.cumsum([0, layers[0].w_in.shape[1], *(len(layer.w_in) for layer in layers)])
    left, cores = _network(layers, edges), []
    while len(left):
        sizes = range(1, min(LIMITS["compartments"], len(left)) + 1)
        fitting = bisect_left(sizes, True, key=lambda size: bool(_core(left[:size]).excess()))
        core = _core(left[: max(fitting, 1)])
        if wrong := core.excess():
            raise ValueError(f"neuron {left[0]['number']} of layer {left[0]['layer']}: {wrong}")
        cores.append(core)
        left = left[fitting:]
    if len(cores) > CORES:
        raise ValueError(
            f"the network needs {len(cores)} cores, a chip has {CORES}: {len(cores) - CORES} too many"
        )
    reached = np.sum([core.synapses.any(0) for core in cores], axis=0)
    for number, core in enumerate(cores):
        fan_out = sum(int(reached[edges[k + 1] + np.array(each)].sum()) for k, each in core.neurons.items())
        cores[number] = replace(core, fan_out=fan_out)
        if wrong := cores[number].excess():
            raise ValueError(f"core {number}: {wrong}")
    return cores


def _core(part: NDArray[np.void]) -> ChipCore:
    """Return the core with some neurons of `_network`."""
    synapses = [np.count_nonzero(part["formats"] == k, axis=0) for k in range(1, 2 - WEIGHT_EXP_MIN)]
    return ChipCore(
        {int(k): part["number"][part["layer"] == k].tolist() for k in np.unique(part["layer"])},
        distinct_profiles(map(tuple, part["profile"].tolist())),
        len(np.unique(part["threshold"])),
        len(part),
        np.stack(synapses),
    )


def decay_profiles(layer: LoihiLayer) -> Ints:
    """Return (du, dv) of the neurons of a layer, (out, 2); du is `ANY` if no spikes enter the layer."""
    dv = layer.dv
    driven = layer.w_in.shape[1] > 0 or layer.w_rec is not None
    return np.stack([layer.du if driven else np.full_like(dv, ANY), dv], axis=1)


def _network(layers: Sequence[LoihiLayer], edges: Ints) -> NDArray[np.void]:
    """Records of all neurons, layer after layer, those of one profile together; `edges` are of the sources.

    `formats` are those of the synapse from each source, counted by 1 - exponent; 0 for none.
    """
    fields = [("layer", int), ("number", int), ("profile", int, 2), ("threshold", int)]
    every = []
    for k, layer in enumerate(layers):
        each = np.zeros(len(layer.w_in), [*fields, ("formats", np.int8, edges[-1])])
        each["layer"], each["number"], each["threshold"] = k, np.arange(len(each)), layer.vth
        each["profile"] = profiles = decay_profiles(layer)
        below = slice(edges[k + 1] - layer.w_in.shape[1], edges[k + 1])
        each["formats"][:, below] = (layer.w_in != 0) * (1 - layer.exp_in)[:, None]
        if layer.w_rec is not None:
            own = slice(edges[k + 1], edges[k + 2])
            each["formats"][:, own] = (layer.w_rec != 0) * (1 - layer.exp_rec)[:, None]
        every.append(each[np.lexsort(profiles.T)])
    return np.concatenate(every)
