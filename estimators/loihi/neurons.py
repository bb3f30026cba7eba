"""Current-based leaky integrate-and-fire neurons: their step in floats and in Loihi's integers, and the chip.

Index t is the value after step t; D(x, d) is what a decay leaves of x. In floats 1.0 is 1.0, D(x, τ) = τ x,
and nothing is rounded or clipped. On the chip all is integer and 1.0 is 2^14 state units:

    D(x, d)  = sign(x) ((|x| (4096 - d)) >> 12)
    u[t] = wrap23( D(u[t-1], du) + wrap21( Σ W s[t-1] 2^(6 + e) ) )
    v[t] = clip( D(v[t-1], dv) + u[t] + (bias_mant << bias_exp), ±(2^23 - 1) )
    s[t] = v[t] > (vth << 6);  v[t] = 0 where s[t]

W are mantissas, e the exponents of their synaptic formats. Every connection, recurrent or not, delivers after
exactly one step; a bias acts within its step.
Davies et al., "Loihi: a neuromorphic manycore processor with on-chip learning", IEEE Micro 38 (2018).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from quadsim.runs.compiled import njit

STATE_ONE = 1 << 14
"""State units of 1.0."""
DECAY_ONE = 4096
"""The decay that forgets everything in one step."""
STATE_MAX = (1 << 23) - 1
VTH_MAX = (1 << 17) - 1
VTH_EXP = 6
BIAS_MANT_MAX = 4095

Numbers = NDArray[np.int32] | NDArray[np.floating]
Whole = int | np.int32


class Neurons(NamedTuple):
    """Neurons in a row and their synapses, in state units: int32 (weights int16) for the chip, or floats.

    The first neurons have no synapses: an input drives them. The others are the targets.
    """

    weights: NDArray[np.int16] | NDArray[np.floating]
    """By source, (sources, targets), where the first neurons are the sources."""
    later: NDArray[np.int16] | NDArray[np.floating]
    """Those that deliver a step later (recurrent delay 2), of the same shape; (0, 0) where none does."""
    first_dv: Numbers  #: decays of the first neurons' potentials (in floats time constants τ), (first,)
    first_vth: Numbers  #: their thresholds
    du: Numbers  #: decays of the targets' currents, as all below of shape (targets,)
    dv: Numbers  #: decays of their potentials
    vth: Numbers  #: thresholds
    bias: Numbers  #: biases


class NeuronState(NamedTuple):
    """What neurons hold, of one copy of the network; potentials before the reset."""

    first_v: Numbers  #: potentials of the first neurons, (first,)
    u: Numbers  #: currents of the targets, (targets,)
    v: Numbers  #: their potentials


@njit(inline="always")
def neurons_of(weights, first, table):
    """`Neurons` of weights (1 or 2, sources, targets) and the rows of a table (4, neurons)."""
    later = weights[1] if weights.shape[0] > 1 else weights[0, :0, :0]
    du, dv, vth, bias = table[0, first:], table[1, first:], table[2, first:], table[3, first:]
    return Neurons(weights[0], later, table[1, :first], table[2, :first], du, dv, vth, bias)


@njit(inline="always")
def list_spikes(neurons, first_v, v, spikes):
    """List the sources above their thresholds: how many, how many of the first ones, and their numbers."""
    count, first = 0, first_v.size
    for i in range(first):  # without a branch: spikes are hard to predict
        spikes[2 + count] = i
        count += first_v[i] > neurons.first_vth[i]
    spikes[1] = count
    for i in range(spikes.size - 2 - first):
        spikes[2 + count] = first + i
        count += v[i] > neurons.vth[i]
    spikes[0] = count


@njit(inline="always")
def _deliver(weights, spikes, sums):
    """Add the weights of the sources that spiked to `sums`, four rows at a time."""
    # Rows are not taken out of the matrix: counting references to them would take longer than adding them.
    fours = spikes[0] - spikes[0] % 4
    for k in range(2, 2 + fours, 4):
        w, x, y, z = spikes[k], spikes[k + 1], spikes[k + 2], spikes[k + 3]
        for i in range(sums.size):
            sums[i] += _added(_added(weights[w, i], weights[x, i]), _added(weights[y, i], weights[z, i]))
    for k in range(2 + fours, 2 + spikes[0]):
        w = spikes[k]
        for i in range(sums.size):
            sums[i] += weights[w, i]


@njit(inline="always")
def step(neurons, drive, state, spikes, before, sums):
    """One step of one copy of the network, whose state changes in place.

    Args:
        neurons: The network.
        drive: What is added to the potentials of the first neurons, (first,) [state units].
        state: State of the copy.
        spikes: `list_spikes` of the step before.
        before: The same of the step before that one; read where weights deliver after two steps.
        sums: Zeros, int32 or as the weights, (targets,), to add in; zeros again afterwards.
    """
    first_v, u, v = state
    _deliver(neurons.weights, spikes, sums)
    if neurons.later.size:
        _deliver(neurons.later, before, sums)
    for j in range(first_v.size):
        first_v[j] = _potential(first_v[j], neurons.first_dv[j], neurons.first_vth[j], drive[j])
    for j in range(u.size):
        current = _current(u[j], neurons.du[j], sums[j])
        u[j], sums[j] = current, 0
        v[j] = _potential(v[j], neurons.dv[j], neurons.vth[j], current + neurons.bias[j])


# --- the arithmetic, of floats and of integers ------------------------------------------------------


def either(floats, integers):
    """A function for compiled code: one of two, by the type of its first argument."""

    def stub(*args):
        raise NotImplementedError

    overload(stub, strict=False)(
        lambda first, *others: floats if isinstance(first, types.Float) else integers
    )
    return stub


_added = either(lambda x, y: x + y, lambda x, y: np.int32(np.int32(x) + np.int32(y)))
"""The sum of two weights."""
_current = either(
    lambda x, d, arriving: x * d + arriving,
    lambda x, d, arriving: wrap(np.int32(decay(x, d) + wrap(np.int32(arriving), 21)), 23),
)
"""A current after a step."""


def _whole_potential(v, d, threshold, drive):
    driven = np.int32(decay(np.int32(0) if v > threshold else v, d) + np.int32(drive))
    return min(max(driven, np.int32(-STATE_MAX)), np.int32(STATE_MAX))


_potential = either(
    lambda v, d, threshold, drive: (0.0 if v > threshold else v) * d + drive, _whole_potential
)
"""A potential after a step, before its reset."""


@njit
def decay(x: Whole, d: Whole) -> np.int32:
    """D(x, d): the part of x that a decay d leaves, rounded toward zero.

    As |x| = 4096 a + b, it is a (4096 - d) + (b (4096 - d) >> 12), and no product needs more than 32 bits.
    """
    keep, size = np.int32(DECAY_ONE - d), np.int32(abs(x))
    high, low = np.int32(size >> 12), np.int32(size & (DECAY_ONE - 1))
    left = np.int32(np.int32(high * keep) + np.int32(np.int32(low * keep) >> 12))
    return np.int32(-left) if x < 0 else left


@njit
def shift(x: Whole, bits: int) -> np.int32:
    """Divide by 2^bits, rounding toward zero, without a branch: signs of currents are hard to predict."""
    return np.int32(np.int32(x + np.int32(np.int32(x >> 31) & ((1 << bits) - 1))) >> bits)


@njit
def wrap(x: Whole, bits: int) -> np.int32:
    """Two's complement with `bits` bits and sign."""
    return np.int32(np.int32(x << (31 - bits)) >> (31 - bits))
