"""Current-based leaky integrate-and-fire neurons: one step in floats and in Loihi's integers.

Index t is the value after step t, and D(x, d) is the value of x after a decay. In floats, D(x, τ) = τ x, and
nothing is rounded or clipped. On the chip, all values are integers, and 1.0 is 2^14 state units:

    D(x, d)  = sign(x) ((|x| (4096 - d)) >> 12)
    u[t] = wrap23( D(u[t-1], du) + wrap21( Σ W s[t-1] 2^(6 + e) ) )
    v[t] = clip( D(v[t-1], dv) + u[t] + (bias_mant << bias_exp), ±(2^23 - 1) )
    s[t] = v[t] > (vth << 6);  v[t] = 0 where s[t]

W are mantissas, and e are the exponents of their synaptic formats. Every connection, including recurrent
ones, delivers after exactly one step; a bias acts within its step. The model is that of Davies et al.,
"Loihi: a neuromorphic manycore processor with on-chip learning", IEEE Micro 38 (2018).
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
"""Decay after which nothing remains in one step."""
STATE_MAX = (1 << 23) - 1
VTH_MAX = (1 << 17) - 1
VTH_EXP = 6
BIAS_MANT_MAX = 4095

Numbers = NDArray[np.int32] | NDArray[np.floating]
Whole = int | np.int32


class Neurons(NamedTuple):
    """Neurons and their synapses, in state units: int32 (weights int16) for the chip, or floats.

    The first neurons have no synapses and are driven by the input. The others are targets of synapses.
    """

    weights: NDArray[np.int16] | NDArray[np.floating]
    """Weights by source, (sources, targets); the first neurons are the sources."""
    later: NDArray[np.int16] | NDArray[np.floating]
    """Weights that deliver one step later (recurrent delay 2), same shape; (0, 0) if there are none."""
    first_dv: Numbers  #: decays of the first neurons' potentials (in floats time constants τ), (first,)
    first_vth: Numbers  #: their thresholds
    du: Numbers  #: decays of the targets' currents, as all below of shape (targets,)
    dv: Numbers  #: decays of their potentials
    vth: Numbers  #: thresholds
    bias: Numbers  #: biases


class NeuronState(NamedTuple):
    """State of the neurons of one copy of the network; potentials are those before the reset."""

    first_v: Numbers  #: potentials of the first neurons, (first,)
    u: Numbers  #: currents of the targets, (targets,)
    v: Numbers  #: their potentials


@njit(inline="always")
def neurons_of(weights, first, table):
    """Return `Neurons` for weights (1 or 2, sources, targets) and the rows of a table (4, neurons)."""
    later = weights[1] if weights.shape[0] > 1 else weights[0, :0, :0]
    du, dv, vth, bias = table[0, first:], table[1, first:], table[2, first:], table[3, first:]
    return Neurons(weights[0], later, table[1, :first], table[2, :first], du, dv, vth, bias)


@njit(inline="always")
def list_spikes(neurons, first_v, v, spikes):
    """List sources above their thresholds: number, number among the first neurons, and indices."""
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
    """Add the weights of sources that spiked to `sums`, four rows at a time."""
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
def step_network(neurons, drive, state, spikes, before, sums):
    """Run one step of one copy of the network, and change its state in place.

    Args:
        neurons: The network.
        drive: Input that is added to the potentials of the first neurons, (first,) [state units].
        state: State of the copy.
        spikes: Result of `list_spikes` for the previous step.
        before: Result of `list_spikes` for the step before it, for weights that deliver after two steps.
        sums: Zeros (targets,), as temporary storage; zeros again afterwards.
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
    """Return a compiled function that calls one of two, depending on the type of the first argument."""

    def stub(*args):
        raise NotImplementedError

    overload(stub, strict=False)(
        lambda first, *others: floats if isinstance(first, types.Float) else integers
    )
    return stub


_added = either(lambda x, y: x + y, lambda x, y: np.int32(np.int32(x) + np.int32(y)))
"""Returns the sum of two weights."""
_current = either(
    lambda x, d, arriving: x * d + arriving,
    lambda x, d, arriving: wrap(np.int32(decay(x, d) + wrap(np.int32(arriving), 21)), 23),
)
"""Returns a current after a step."""


def _whole_potential(v, d, threshold, drive):
    driven = np.int32(decay(np.int32(0) if v > threshold else v, d) + np.int32(drive))
    return min(max(driven, np.int32(-STATE_MAX)), np.int32(STATE_MAX))


_potential = either(
    lambda v, d, threshold, drive: (0.0 if v > threshold else v) * d + drive, _whole_potential
)
"""Returns a potential after a step, before the reset."""


@njit
def decay(x: Whole, d: Whole) -> np.int32:
    """Return D(x, d), the value of x after a decay d, rounded toward zero.

    With |x| = 4096 a + b, the result is a (4096 - d) + (b (4096 - d) >> 12), so that no product needs more
    than 32 bits.
    """
    keep, size = np.int32(DECAY_ONE - d), np.int32(abs(x))
    high, low = np.int32(size >> 12), np.int32(size & (DECAY_ONE - 1))
    left = np.int32(np.int32(high * keep) + np.int32(np.int32(low * keep) >> 12))
    return np.int32(-left) if x < 0 else left


@njit
def shift(x: Whole, bits: int) -> np.int32:
    """Divide by 2^bits, rounded toward zero, without a branch, because signs are unpredictable."""
    return np.int32(np.int32(x + np.int32(np.int32(x >> 31) & ((1 << bits) - 1))) >> bits)


@njit
def wrap(x: Whole, bits: int) -> np.int32:
    """Wrap to two's complement with `bits` bits and a sign."""
    return np.int32(np.int32(x << (31 - bits)) >> (31 - bits))
