"""Emulated Loihi: current-based leaky integrate-and-fire neurons in the chip's integer arithmetic.

All integer; index t is the value after step t; 1.0 is 2^14 state units.

    D(x, d)  = sign(x) ((|x| (4096 - d)) >> 12)
    u[t] = wrap23( D(u[t-1], du) + wrap21( (W s[t-1]) << 6 ) )
    v[t] = clip( D(v[t-1], dv) + u[t] + (bias_mant << bias_exp), ±(2^23 - 1) )
    s[t] = v[t] > (vth << 6);  v[t] = 0 where s[t]

Every connection, recurrent or not, delivers after exactly one step; a bias acts within its step.
Davies et al., "Loihi: a neuromorphic manycore processor with on-chip learning", IEEE Micro 38 (2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.runs.compiled import njit

STATE_ONE = 1 << 14
"""State units of 1.0."""
DECAY_ONE = 4096
"""The decay that forgets everything in one step."""
STATE_MAX = (1 << 23) - 1
WEIGHT_MIN, WEIGHT_MAX = -256, 254
VTH_MAX = (1 << 17) - 1
BIAS_MANT_MIN, BIAS_MANT_MAX = -4096, 4095
BIAS_EXP_MAX = 7

Ints = NDArray[np.int64]


@dataclass
class LoihiLayer:
    """One population of neurons, its input and its recurrent connections.

    Args:
        w_in: Mantissas of the weights from the layer below (from the network's input for the first layer),
            even, -256...254, shape (out, in). None: the layer is driven by its bias alone.
        w_rec: Mantissas of the recurrent weights, shape (out, out). None: no recurrence.
        du: Effective decay of the current, 0...4096, scalar or shape (out,).
        dv: Effective decay of the membrane, 0...4096, scalar or shape (out,).
        vth: Mantissa of the threshold (vth * 64 state units), 0...131071, scalar or shape (out,).
        bias_mant: Mantissa of the bias, -4096...4095, scalar or shape (out,).
        bias_exp: Exponent of the bias, 0...7, scalar or shape (out,).

    Raises:
        ValueError: A shape that does not fit, or a value that the chip cannot hold.
    """

    w_in: ArrayLike | None
    w_rec: ArrayLike | None = None
    du: ArrayLike = DECAY_ONE
    dv: ArrayLike = DECAY_ONE
    vth: ArrayLike = 128
    bias_mant: ArrayLike = 0
    bias_exp: ArrayLike = 0

    def __post_init__(self) -> None:
        """Turn everything into checked integer arrays of the layer's size."""
        size = _layer_size(self)
        self.w_in = _weights("w_in", self.w_in, size, None)
        self.w_rec = None if self.w_rec is None else _weights("w_rec", self.w_rec, size, size)
        self.du = _vector("du", self.du, size, 0, DECAY_ONE)
        self.dv = _vector("dv", self.dv, size, 0, DECAY_ONE)
        self.vth = _vector("vth", self.vth, size, 0, VTH_MAX)
        self.bias_mant = _vector("bias_mant", self.bias_mant, size, BIAS_MANT_MIN, BIAS_MANT_MAX)
        self.bias_exp = _vector("bias_exp", self.bias_exp, size, 0, BIAS_EXP_MAX)


class LoihiNetwork:
    """Layers in a chain, stepped together: in one step every layer reads the spikes of the previous step.

    After `step`, `u`, `v` and `s` hold the currents, membrane potentials (after reset) and spikes of each
    layer: a list with one (n, out) array per layer. The arrays are overwritten by the next step.

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
        w_in = [np.asarray(layer.w_in) for layer in layers]
        for k in range(1, len(layers)):
            if w_in[k].shape[1] not in (0, w_in[k - 1].shape[0]):
                raise ValueError(
                    f"layer {k}: w_in has {w_in[k].shape[1]} inputs, but layer {k - 1} has "
                    f"{w_in[k - 1].shape[0]} neurons"
                )
        self.n_in = w_in[0].shape[1]
        self.sizes = [w.shape[0] for w in w_in]
        # The sources of all spikes stand in one row: the network's input, then layer after layer.
        self._start = np.cumsum([self.n_in, *self.sizes]).astype(np.int64)
        fan_in = [np.vstack([w.T, _recurrent_rows(layer)]) for w, layer in zip(w_in, layers, strict=True)]
        rows = np.array([(w.shape[1], r.shape[0]) for w, r in zip(w_in, fan_in, strict=True)], np.int64)
        weights = np.concatenate([r.ravel() for r in fan_in]).astype(np.int32)
        vectors = [
            np.concatenate([np.asarray(getattr(layer, name)) for layer in layers]).astype(np.int64)
            for name in ("bias_mant", "bias_exp", "du", "dv", "vth")
        ]
        self.bias_mant = vectors[0]
        self.parameters = (vectors[1], weights, rows, self._start, *vectors[2:])
        """What `step_arrays` takes after the state."""
        self.reset()

    def zero_state(self, n: int) -> tuple[NDArray[np.int8], NDArray[np.int8], Ints, Ints, Ints]:
        """State of `n` copies at rest: spikes before and after a step, currents, potentials, biases."""
        total = int(self._start[-1]) - self.n_in
        spikes = np.zeros((2, n, self.n_in + total), np.int8)
        bias = np.tile(self.bias_mant, (n, 1))
        return spikes[0], spikes[1], np.zeros((n, total), np.int64), np.zeros((n, total), np.int64), bias

    def reset(self, n: int = 1) -> None:
        """Set the currents, potentials and spikes of `n` independent copies to zero."""
        self._state = self.zero_state(n)
        _, after, u, v, _ = self._state
        edges = self._start[1:-1] - self.n_in
        self.u: list[Ints] = np.split(u, edges, axis=1)
        self.v: list[Ints] = np.split(v, edges, axis=1)
        self.s: list[NDArray[np.int8]] = np.split(after[:, self.n_in :], edges, axis=1)

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
        _, after, u, _, bias = self._state
        n, first = u.shape[0], self.sizes[0]
        after[:, : self.n_in] = 0 if spikes_in is None else _fit("spikes_in", spikes_in, n, self.n_in)
        bias[:, :first] = (
            self.bias_mant[:first] if bias_mant is None else _fit("bias_mant", bias_mant, n, first)
        )
        step_arrays(*self._state, *self.parameters)
        return self.s[-1]


@njit(cache=True, inline="always")
def decay(x: int, d: int) -> int:
    """D(x, d): the part of x that a decay d leaves, rounded toward zero."""
    return shift(x * (DECAY_ONE - d), 12)


@njit(cache=True, inline="always")
def shift(x: int, bits: int) -> int:
    """Divide by 2^bits, rounding toward zero, without a branch: signs of currents are hard to predict."""
    return (x + ((x >> 63) & ((1 << bits) - 1))) >> bits


@njit(cache=True, inline="always")
def wrap(x: int, bits: int) -> int:
    """Two's complement with `bits` bits and sign."""
    return ((x + (1 << bits)) & ((1 << (bits + 1)) - 1)) - (1 << bits)


@njit(cache=True)
def step_arrays(before, after, u, v, bias, bias_exp, weights, rows, start, du, dv, vth):
    """One step of `n` copies: all layers read the spikes in `before`, and `after` gets the new ones.

    Args:
        before: Spikes one step ago, the network's input first, shape (n, in + neurons); overwritten.
        after: Spikes after the last step, and in its first columns those of this step's input; changed.
        u: Currents, shape (n, neurons); changed.
        v: Membrane potentials after the reset, shape (n, neurons); changed.
        bias: Bias mantissas of this step, shape (n, neurons).
        bias_exp: Exponents of the biases, shape (neurons,).
        weights: For each layer the rows of its feed-forward and of its recurrent sources, flattened.
        rows: Numbers of these rows, shape (layers, 2).
        start: First source of each layer in `before`, shape (layers + 1,).
        du: Decays of the currents, shape (neurons,).
        dv: Decays of the potentials, shape (neurons,).
        vth: Threshold mantissas, shape (neurons,).
    """
    n_in = start[0]
    dendrite = np.empty(u.shape[1], np.int32)
    for b in range(u.shape[0]):
        sent, arrive, currents, potentials = before[b], after[b], u[b], v[b]
        sent[n_in:] = arrive[n_in:]
        dendrite[:] = 0
        offset = 0
        for k in range(rows.shape[0]):
            into = dendrite[start[k] - n_in : start[k + 1] - n_in]
            below = 0 if k == 0 else start[k - 1]
            for row in range(rows[k, 1]):
                source = below + row if row < rows[k, 0] else start[k] + row - rows[k, 0]
                if sent[source] != 0:
                    begin = offset + row * into.size
                    weight = weights[begin : begin + into.size]
                    for i in range(into.size):
                        into[i] += weight[i]
            offset += rows[k, 1] * into.size
        for j in range(currents.size):  # short loops without branches, for the vector unit
            currents[j] = wrap(decay(currents[j], du[j]) + wrap(int(dendrite[j]) << 6, 21), 23)
        for j in range(currents.size):
            driven = decay(potentials[j], dv[j]) + currents[j] + (bias[b, j] << bias_exp[j])
            potentials[j] = min(max(driven, -STATE_MAX), STATE_MAX)
        for j in range(currents.size):
            fires = potentials[j] > vth[j] << 6
            arrive[n_in + j] = fires
            potentials[j] = 0 if fires else potentials[j]
        sent[:n_in] = arrive[:n_in]


def _layer_size(layer: LoihiLayer) -> int:
    if layer.w_in is not None:
        shape = np.shape(layer.w_in)
        if len(shape) != 2:
            raise ValueError(f"w_in: shape {shape}, should be (out, in)")
        return shape[0]
    if layer.w_rec is not None:
        return np.shape(layer.w_rec)[0]
    return max(np.size(x) for x in (layer.du, layer.dv, layer.bias_mant))


def _weights(name: str, value: ArrayLike | None, size: int, fan_in: int | None) -> NDArray[np.int32]:
    w = _integers(name, np.zeros((size, 0)) if value is None else value)
    if w.ndim != 2 or w.shape[0] != size or fan_in not in (None, w.shape[1]):
        raise ValueError(f"{name}: shape {w.shape}, should be ({size}, {'in' if fan_in is None else fan_in})")
    _check_range(name, w, WEIGHT_MIN, WEIGHT_MAX)
    if np.any(w % 2):
        raise ValueError(f"{name}: weight mantissa {w[w % 2 != 0][0]} is odd, only even ones exist")
    return w.astype(np.int32)


def _vector(name: str, value: ArrayLike, size: int, low: int, high: int) -> Ints:
    x = _integers(name, value)
    if x.ndim > 1 or x.size not in (1, size):
        raise ValueError(f"{name}: shape {x.shape}, should be a scalar or ({size},)")
    _check_range(name, x, low, high)
    return np.broadcast_to(x.reshape(-1), size).copy()


def _integers(name: str, value: ArrayLike) -> Ints:
    x = np.asarray(value)
    if not np.all(np.equal(x, np.floor(x))):
        raise ValueError(f"{name}: has values that are not whole numbers")
    return x.astype(np.int64)


def _check_range(name: str, x: Ints, low: int, high: int) -> None:
    wrong = x[(x < low) | (x > high)]
    if wrong.size:
        raise ValueError(f"{name}: value {wrong.flat[0]}, allowed are {low}...{high}")


def _recurrent_rows(layer: LoihiLayer) -> NDArray[np.int32]:
    size = np.asarray(layer.w_in).shape[0]
    return np.zeros((0, size), np.int32) if layer.w_rec is None else np.asarray(layer.w_rec).T


def _fit(name: str, value: ArrayLike, n: int, size: int) -> NDArray[np.generic]:
    x = np.asarray(value)
    if x.shape not in ((n, size), (size,)):
        raise ValueError(f"{name}: shape {x.shape}, should be ({n}, {size})")
    return x
