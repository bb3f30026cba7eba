"""Layers of neurons on the emulated chip, and networks of layers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.runs.compiled import njit

from .neurons import (
    BIAS_MANT_MAX,
    DECAY_ONE,
    VTH_EXP,
    VTH_MAX,
    NeuronState,
    list_spikes,
    neurons_of,
    step_network,
)

WEIGHT_MIN, WEIGHT_MAX = -256, 254
WEIGHT_EXP_MIN = -6
"""Smallest supported weight exponent. The chip has exponents from -8 to 7; those from -6 to 0 need no
rounding and at most 16 bits."""
BIAS_MANT_MIN = -4096
BIAS_EXP_MAX = 7

Ints = NDArray[np.int64]
Int32s = NDArray[np.int32]


class LoihiLayer:
    """One population of neurons, its input and its recurrent connections.

    Args:
        w_in: Mantissas of the weights from the layer below (from the network's input for the first layer),
            even, -256...254, shape (out, in). None: the layer is driven by its bias alone.
        w_rec: Mantissas of the recurrent weights, shape (out, out). None: no recurrence.
        du: Effective decay of the current, 0...4096. This and the following arguments are scalars or have the
            shape (out,).
        dv: Effective decay of the membrane, 0...4096.
        vth: Mantissa of the threshold (vth * 64 state units), 0...131071.
        bias_mant: Mantissa of the bias, -4096...4095.
        bias_exp: Exponent of the bias, 0...7.
        exp_in: Exponent of the weights `w_in` into each neuron, -6...0.
        exp_rec: Exponent of the weights `w_rec` into each neuron, -6...0.

    Raises:
        ValueError: A shape does not fit, or the chip cannot represent a value.
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


class LoihiNetwork:
    """A chain of layers, stepped together: every layer reads the spikes of the previous step.

    After `step`, `u`, `v` and `s` contain currents, membrane potentials (after reset) and spikes: lists with
    one array (n, out) per layer, int32 or, for spikes, int8.

    Args:
        layers: From the input to the output.

    Raises:
        ValueError: There are no layers, or the sizes of neighbours do not fit.
    """

    def __init__(self, layers: Sequence[LoihiLayer]) -> None:
        if not layers:
            raise ValueError("a network needs at least one layer, got none")
        self.layers = list(layers)
        sizes = [len(layer.w_in) for layer in layers]
        for k, size in enumerate(sizes[:-1]):
            inputs = layers[k + 1].w_in.shape[1]
            if inputs not in (0, size):
                raise ValueError(f"layer {k + 1}: w_in has {inputs} inputs, but layer {k} has {size} neurons")
        # the network's inputs are the first neurons: they repeat what drives them
        self._edges = np.cumsum([0, layers[0].w_in.shape[1], *sizes])
        self._weights, self._table = _packed(layers, self._edges)
        self.reset()

    def reset(self, n: int = 1) -> None:
        """Set the currents, potentials and spikes of `n` independent copies to zero."""
        inputs, targets = self._edges[1], self._edges[-1] - self._edges[1]
        self._state = NeuronState(*(np.zeros((n, k), np.int32) for k in (inputs, targets, targets)))

    def step(
        self, spikes_in: ArrayLike | None = None, bias_mant: ArrayLike | None = None
    ) -> NDArray[np.int8]:
        """Run one step of the whole network.

        Args:
            spikes_in: Spikes of this step on the network's input, 0 or 1, shape (n, in); they enter the
                currents of the first layer in the next step. None: no spikes.
            bias_mant: Bias mantissas of the first layer in this step only, shape (n, out) or (out,). None:
                the bias of the layer.

        Returns:
            The spikes of the last layer, shape (n, out).

        Raises:
            ValueError: A shape does not fit, a spike is not 0 or 1, or the chip cannot represent the bias.
        """
        n, inputs = self._state.first_v.shape
        own = slice(self._edges[1], self._edges[2])
        drive = np.zeros((n, inputs), np.int32)
        if spikes_in is not None:
            arriving = _fit("spikes_in", spikes_in, n, inputs)
            if not np.all((arriving == 0) | (arriving == 1)):
                raise ValueError("spikes_in: spikes are 0 or 1")
            drive[:] = arriving
        tables = np.tile(self._table, (n, 1, 1))
        if bias_mant is not None:
            given = _fit("bias_mant", bias_mant, n, len(self.layers[0].w_in))
            mantissas = _whole("bias_mant", given, BIAS_MANT_MIN, BIAS_MANT_MAX)
            tables[:, 3, own] = mantissas << self.layers[0].bias_exp
        _step_all(self._weights, tables, drive, self._state)
        return self.s[-1]

    @property
    def u(self) -> list[Int32s]:
        """Currents of each layer, (n, out)."""
        return self._by_layer(self._state.u)

    @property
    def v(self) -> list[Int32s]:
        """Membrane potentials of each layer after the reset, (n, out)."""
        return self._by_layer(np.where(self._fired, 0, self._state.v))

    @property
    def s(self) -> list[NDArray[np.int8]]:
        """Spikes of each layer, (n, out)."""
        return self._by_layer(self._fired.astype(np.int8))

    @property
    def _fired(self) -> NDArray[np.bool_]:
        return self._state.v > self._table[2, self._edges[1] :]

    def _by_layer(self, values: NDArray) -> list[NDArray]:
        return np.split(values, self._edges[2:-1] - self._edges[1], axis=1)


def _packed(layers: Sequence[LoihiLayer], edges: Ints) -> tuple[NDArray[np.int16], Int32s]:
    """Weights (1, sources, targets) and the rows of a table (4, sources), as `neurons_of` takes them."""
    inputs = edges[1]
    weights = np.zeros((1, edges[-1], edges[-1] - inputs), np.int16)
    table = np.zeros((4, edges[-1]), np.int32)
    table[:2, :inputs] = DECAY_ONE
    for k, layer in enumerate(layers, 1):
        below = slice(edges[k - 1], edges[k])
        own = slice(edges[k], edges[k + 1])
        targets = slice(own.start - inputs, own.stop - inputs)
        if layer.w_in.shape[1]:
            weights[0, below, targets] = layer.w_in.T << (VTH_EXP + layer.exp_in)
        if layer.w_rec is not None:
            weights[0, own, targets] = layer.w_rec.T << (VTH_EXP + layer.exp_rec)
        table[:, own] = [
            layer.du,
            layer.dv,
            layer.vth << VTH_EXP,
            layer.bias_mant << layer.bias_exp,
        ]
    return weights, table


@njit(cache=True)
def _step_all(weights, tables, drive, states):
    """One step of all copies: tables (n, 4, sources), drive (n, in), states in rows."""
    spikes = np.empty(weights.shape[1] + 2, np.int32)
    sums = np.zeros(weights.shape[2], np.int32)
    for n in range(drive.shape[0]):
        neurons = neurons_of(weights, drive.shape[1], tables[n])
        copy = NeuronState(states.first_v[n], states.u[n], states.v[n])
        list_spikes(neurons, copy.first_v, copy.v, spikes)
        step_network(neurons, drive[n], copy, spikes, spikes, sums)


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
