"""Emulated Loihi: current-based leaky integrate-and-fire neurons in the chip's integer arithmetic.

All integer; index t is the value after step t; 1.0 is 2^14 state units.

    D(x, d)  = sign(x) ((|x| (4096 - d)) >> 12)
    u[t] = wrap23( D(u[t-1], du) + wrap21( Σ W s[t-1] 2^(6 + e) ) )
    a[t] = wrap23( D(a[t-1], d_after) + w_after s[t-1] 2^(6 + e) )
    v[t] = clip( D(v[t-1], dv) + u[t] + a[t] + (bias_mant << bias_exp), ±(2^23 - 1) )
    s[t] = v[t] > (vth << 6);  v[t] = 0 where s[t]

W and w_after are mantissas, e the exponents of their synaptic formats. Every connection, recurrent or not,
delivers after exactly one step; a bias acts within its step. An after-spike current a is that of a second
compartment, which the neuron alone has a synapse on and which never spikes; the soma adds its current (an ADD
join).
Davies et al., "Loihi: a neuromorphic manycore processor with on-chip learning", IEEE Micro 38 (2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.runs.compiled import njit

STATE_ONE = 1 << 14
"""State units of 1.0."""
DECAY_ONE = 4096
"""The decay that forgets everything in one step."""
STATE_MAX = (1 << 23) - 1
WEIGHT_MIN, WEIGHT_MAX = -256, 254
WEIGHT_EXP_MIN = -6
"""The chip has exponents from -8 to 7; these are the ones that need no rounding and no more than 16 bits."""
VTH_MAX = (1 << 17) - 1
BIAS_MANT_MIN, BIAS_MANT_MAX = -4096, 4095
BIAS_EXP_MAX = 7

Ints = NDArray[np.int64]
Int32s = NDArray[np.int32]
Whole = int | np.int32


class LoihiLayer:
    """One population of neurons, its input and its recurrent connections.

    Args:
        w_in: Mantissas of the weights from the layer below (from the network's input for the first layer),
            even, -256...254, shape (out, in). None: the layer is driven by its bias alone.
        w_rec: Mantissas of the recurrent weights, shape (out, out). None: no recurrence.
        du: Effective decay of the current, 0...4096, as those below a scalar or of shape (out,).
        dv: Effective decay of the membrane, 0...4096.
        vth: Mantissa of the threshold (vth * 64 state units), 0...131071.
        bias_mant: Mantissa of the bias, -4096...4095.
        bias_exp: Exponent of the bias, 0...7.
        exp_in: Exponent of the weights `w_in` into each neuron, -6...0.
        exp_rec: The same of `w_rec`.
        w_after: Mantissas of the weights of the neurons on their own after-spike currents; 0: no such
            current.
        d_after: Effective decay of these currents, 0...4096.
        exp_after: Exponent of `w_after`, -6...0.

    Raises:
        ValueError: A shape that does not fit, or a value that the chip cannot hold.
    """

    def __init__(
        self,
        w_in: ArrayLike | None,
        w_rec: ArrayLike | None = None,
        du: ArrayLike = DECAY_ONE,
        dv: ArrayLike = DECAY_ONE,
        vth: ArrayLike = 128,
        bias_mant: ArrayLike = 0,
        bias_exp: ArrayLike = 0,
        *,
        exp_in: ArrayLike = 0,
        exp_rec: ArrayLike = 0,
        w_after: ArrayLike = 0,
        d_after: ArrayLike = DECAY_ONE,
        exp_after: ArrayLike = 0,
    ) -> None:
        weights = w_rec if w_in is None else w_in
        size = max(map(np.size, (du, dv, bias_mant))) if weights is None else len(np.asarray(weights))
        self.w_in = _weights("w_in", np.zeros((size, 0)) if w_in is None else w_in, (size, None))
        self.w_rec = None if w_rec is None else _weights("w_rec", w_rec, (size, size))
        self.du = _vector("du", du, size, 0, DECAY_ONE)
        self.dv = _vector("dv", dv, size, 0, DECAY_ONE)
        self.vth = _vector("vth", vth, size, 0, VTH_MAX)
        self.bias_mant = _vector("bias_mant", bias_mant, size, BIAS_MANT_MIN, BIAS_MANT_MAX)
        self.bias_exp = _vector("bias_exp", bias_exp, size, 0, BIAS_EXP_MAX)
        self.exp_in = _vector("exp_in", exp_in, size, WEIGHT_EXP_MIN, 0)
        self.exp_rec = _vector("exp_rec", exp_rec, size, WEIGHT_EXP_MIN, 0)
        own = np.broadcast_to(np.asarray(w_after), size)
        self.w_after = _weights("w_after", own[:, None], (size, 1))[:, 0]
        self.d_after = _vector("d_after", d_after, size, 0, DECAY_ONE)
        self.exp_after = _vector("exp_after", exp_after, size, WEIGHT_EXP_MIN, 0)


class Chip(NamedTuple):
    """A network as the chip holds it. Spikes have sources: its inputs, then its neurons, layer by layer."""

    weights: NDArray[np.int16]  #: weights by source [state units], shape (sources, neurons)
    first: Int32s  #: first neuron that a source has synapses on, shape (sources,)
    end: Int32s  #: the neuron after the last of these, shape (sources,)
    bias_exp: Int32s  #: exponents of the biases, as the next three of shape (neurons,)
    du: Int32s  #: decays of the currents
    dv: Int32s  #: decays of the membrane potentials
    vth: Int32s  #: mantissas of the thresholds
    after: Int32s
    """Weights of the neurons on their after-spike currents [state units]; (0,) where no neuron has any."""
    d_after: Int32s  #: decays of these currents, of the same shape


class ChipState(NamedTuple):
    """What the chip's neurons hold: of one copy of the network, or one row for each copy."""

    spikes: NDArray[np.int8]  #: spikes of the last step, 0 or 1, shape (n, sources)
    u: Int32s  #: currents, shape (n, neurons)
    v: Int32s  #: membrane potentials after the reset, shape (n, neurons)
    a: Int32s  #: after-spike currents, shape (n, neurons)
    bias: Int32s  #: bias mantissas, shape (n, neurons)


class LoihiNetwork:
    """Layers in a chain, stepped together: in one step every layer reads the spikes of the previous step.

    After `step`, `u`, `v` and `s` hold the currents, membrane potentials (after reset) and spikes of each
    layer: a list with one (n, out) array per layer, of int32 and for spikes of int8. The arrays are
    overwritten by the next step.

    Args:
        layers: From the input to the output.

    Raises:
        ValueError: No layer, or neighbours whose sizes do not fit.
    """

    def __init__(self, layers: Sequence[LoihiLayer]) -> None:
        """Check that the layers fit, pack them, and start one copy from zero."""
        if not layers:
            raise ValueError("a network needs at least one layer, got none")
        self.layers = list(layers)
        self.n_in = layers[0].w_in.shape[1]
        self.sizes = [len(layer.w_in) for layer in layers]
        for k, size in enumerate(self.sizes[:-1]):
            inputs = layers[k + 1].w_in.shape[1]
            if inputs not in (0, size):
                raise ValueError(f"layer {k + 1}: w_in has {inputs} inputs, but layer {k} has {size} neurons")
        self.parameters = _chip(self.layers)
        self.bias_mant = np.concatenate([layer.bias_mant for layer in layers]).astype(np.int32)
        self.reset()

    def rest(self, n: int) -> ChipState:
        """States of `n` copies at rest."""
        sources, neurons = self.parameters.weights.shape
        u, v, a = np.zeros((3, n, neurons), np.int32)
        return ChipState(np.zeros((n, sources), np.int8), u, v, a, np.tile(self.bias_mant, (n, 1)))

    def reset(self, n: int = 1) -> None:
        """Set the currents, potentials and spikes of `n` independent copies to zero."""
        self._state = self.rest(n)
        edges = np.cumsum(self.sizes)[:-1]
        self.u: list[Int32s] = np.split(self._state.u, edges, axis=1)
        self.v: list[Int32s] = np.split(self._state.v, edges, axis=1)
        self.s: list[NDArray[np.int8]] = np.split(self._state.spikes[:, self.n_in :], edges, axis=1)

    def step(
        self, spikes_in: ArrayLike | None = None, bias_mant: ArrayLike | None = None
    ) -> NDArray[np.int8]:
        """One step of the whole network.

        Args:
            spikes_in: Spikes of this step on the network's input, 0 or 1, shape (n, in); they enter the
                currents of the first layer in the next step. None: no spikes.
            bias_mant: Bias mantissas of the first layer in this step only, shape (n, out) or (out,).
                None: the layer's own.

        Returns:
            The spikes of the last layer, shape (n, out).

        Raises:
            ValueError: A shape that does not fit.
        """
        state, first = self._state, self.sizes[0]
        n = len(state.u)
        arriving = 0 if spikes_in is None else _fit("spikes_in", spikes_in, n, self.n_in)
        own = self.bias_mant[:first]
        state.bias[:, :first] = own if bias_mant is None else _fit("bias_mant", bias_mant, n, first)
        _step_all(self.parameters, state)
        state.spikes[:, : self.n_in] = arriving
        return self.s[-1]


@njit(cache=True, inline="always")
def decay(x: Whole, d: Whole) -> np.int32:
    """D(x, d): the part of x that a decay d leaves, rounded toward zero.

    As |x| = 4096 a + b, it is a (4096 - d) + (b (4096 - d) >> 12), and no product needs more than 32 bits.
    """
    keep, size = np.int32(DECAY_ONE - d), np.int32(abs(x))
    high, low = np.int32(size >> 12), np.int32(size & (DECAY_ONE - 1))
    left = np.int32(np.int32(high * keep) + np.int32(np.int32(low * keep) >> 12))
    return np.int32(-left) if x < 0 else left


@njit(cache=True, inline="always")
def shift(x: Whole, bits: int) -> np.int32:
    """Divide by 2^bits, rounding toward zero, without a branch: signs of currents are hard to predict."""
    return np.int32(np.int32(x + np.int32(np.int32(x >> 31) & ((1 << bits) - 1))) >> bits)


@njit(cache=True, inline="always")
def wrap(x: Whole, bits: int) -> np.int32:
    """Two's complement with `bits` bits and sign."""
    return np.int32(np.int32(x << (31 - bits)) >> (31 - bits))


@njit(cache=True, inline="always")
def deliver(chip, spikes, sources, sums):
    """Add the weights from the sources that spiked to `sums`, four rows at a time."""
    count = 0
    for source in range(spikes.size):  # without a branch: spikes are hard to predict
        sources[count] = source
        count += spikes[source] != 0
    fours = count - count % 4
    for k in range(0, fours, 4):
        a, b, c, d = sources[k], sources[k + 1], sources[k + 2], sources[k + 3]
        first = min(min(chip.first[a], chip.first[b]), min(chip.first[c], chip.first[d]))
        end = max(max(chip.end[a], chip.end[b]), max(chip.end[c], chip.end[d]))
        w, x = chip.weights[a, first:end], chip.weights[b, first:end]
        y, z = chip.weights[c, first:end], chip.weights[d, first:end]
        into = sums[first:end]
        for i in range(into.size):
            into[i] += np.int32(np.int32(w[i] + x[i]) + np.int32(y[i] + z[i]))
    for k in range(fours, count):
        first, end = chip.first[sources[k]], chip.end[sources[k]]
        w, into = chip.weights[sources[k], first:end], sums[first:end]
        for i in range(into.size):
            into[i] += w[i]


@njit(cache=True, inline="always")
def step(chip, state, sources, sums):
    """One step of one copy: every layer reads the spikes of the step before; the state changes in place.

    Args:
        chip: The network.
        state: State of the copy.
        sources: Memory, int32, shape (sources,).
        sums: Zeros, int32, shape (neurons,), to add in; zeros again afterwards.
    """
    spikes, u, v, a, bias = state.spikes, state.u, state.v, state.a, state.bias
    deliver(chip, spikes, sources, sums)
    fired = spikes[spikes.size - u.size :]
    for j in range(chip.after.size):
        own = chip.after[j] if fired[j] else np.int32(0)
        a[j] = wrap(np.int32(decay(a[j], chip.d_after[j]) + own), 23)
    for j in range(u.size):  # without branches, for the vector unit
        arriving = wrap(sums[j], 21)
        current = wrap(np.int32(decay(u[j], chip.du[j]) + arriving), 23)
        driven = np.int32(decay(v[j], chip.dv[j]) + current + a[j] + (bias[j] << chip.bias_exp[j]))
        potential = min(max(driven, np.int32(-STATE_MAX)), np.int32(STATE_MAX))
        fires = potential > chip.vth[j] << 6
        u[j], sums[j] = current, 0
        fired[j], v[j] = fires, np.int32(0) if fires else potential


@njit(cache=True)
def _step_all(chip, state):
    """One step of all copies, whose states are rows."""
    sources, sums = np.empty(chip.weights.shape[0], np.int32), np.zeros(chip.weights.shape[1], np.int32)
    for n in range(state.u.shape[0]):
        copy = ChipState(state.spikes[n], state.u[n], state.v[n], state.a[n], state.bias[n])
        step(chip, copy, sources, sums)


def _chip(layers: Sequence[LoihiLayer]) -> Chip:
    """The layers in one record: a source's row of weights begins with its own layer, if that is recurrent."""
    n_in = layers[0].w_in.shape[1]
    edges = np.cumsum([0, *(len(layer.w_in) for layer in layers)])
    weights = np.zeros((n_in + edges[-1], edges[-1]), np.int16)
    first, end = np.zeros((2, len(weights)), np.int32)
    below = slice(0, n_in)
    for k, layer in enumerate(layers):
        own = slice(edges[k], edges[k + 1])
        sources = slice(n_in + own.start, n_in + own.stop)
        if layer.w_in.shape[1]:
            weights[below, own], end[below] = layer.w_in.T << (6 + layer.exp_in), own.stop
        if layer.w_rec is not None:
            weights[sources, own] = layer.w_rec.T << (6 + layer.exp_rec)
        first[sources], end[sources] = own.stop if layer.w_rec is None else own.start, own.stop
        below = sources
    bias_exp, du, dv, vth, w_after, exp_after, d_after = (
        np.concatenate([getattr(layer, name) for layer in layers]).astype(np.int32)
        for name in ("bias_exp", "du", "dv", "vth", "w_after", "exp_after", "d_after")
    )
    used = slice(None if w_after.any() else 0)
    after = w_after[used] << (6 + exp_after[used])
    return Chip(weights, first, end, bias_exp, du, dv, vth, after, d_after[used])


def _weights(name: str, value: ArrayLike, shape: tuple[int, int | None]) -> NDArray[np.int32]:
    w = _whole(name, value, WEIGHT_MIN, WEIGHT_MAX)
    if w.ndim != 2 or w.shape[0] != shape[0] or shape[1] not in (None, w.shape[1]):
        raise ValueError(f"{name}: shape {w.shape}, should be ({shape[0]}, {shape[1] or 'in'})")
    if np.any(w % 2):
        raise ValueError(f"{name}: weight mantissa {w[w % 2 != 0][0]} is odd, only even ones exist")
    return w.astype(np.int32)


def _vector(name: str, value: ArrayLike, size: int, low: int, high: int) -> Ints:
    x = _whole(name, value, low, high)
    if x.ndim > 1 or x.size not in (1, size):
        raise ValueError(f"{name}: shape {x.shape}, should be a scalar or ({size},)")
    return np.broadcast_to(x.reshape(-1), size).copy()


def _whole(name: str, value: ArrayLike, low: int, high: int) -> Ints:
    x = np.asarray(value)
    if not np.all(np.equal(x, np.floor(x))):
        raise ValueError(f"{name}: has values that are not whole numbers")
    if np.any(wrong := (x < low) | (x > high)):
        raise ValueError(f"{name}: value {x[wrong].flat[0]}, allowed are {low}...{high}")
    return x.astype(np.int64)


def _fit(name: str, value: ArrayLike, n: int, size: int) -> NDArray[np.generic]:
    x = np.asarray(value)
    if x.shape not in ((n, size), (size,)):
        raise ValueError(f"{name}: shape {x.shape}, should be ({n}, {size})")
    return x
