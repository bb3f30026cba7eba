"""Two GRU layers and a linear output, compiled; the equations of `torch.nn.GRU` (Cho et al. 2014).

    r = σ(W_ir x + b_ir + W_hr h + b_hr)
    z = σ(W_iz x + b_iz + W_hz h + b_hz)
    n = tanh(W_in x + b_in + r (W_hn h + b_hn))
    h ← (1 - z) n + z h

Several copies of the network, and several samples for what does not depend on the state of the layer, go
through a matrix together. Every sum is taken in the order of the inputs, with products contracted
(`fma`), so that the numbers of one copy do not depend on the others or on how many samples there are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.block import block_type, matrix, packed, vector
from quadsim.runs.compiled import njit

from .encoder import ENCODER, INPUT_ONE, Scaling, encode_sample, input_scaling
from .weights_file import NetworkConfig, Tensors

Floats = NDArray[np.float32]

COPIES = 8
"""Copies that go through a matrix together."""
ROWS = 32
"""Most inputs of a layer, of all copies and samples, that go through its matrix together."""

_HALF = np.float32(0.5)
_TANH_ONE = np.float32(7.90531110763549805)
"""From here on tanh is 1."""
_P1, _P3, _P5, _P7, _P9, _P11, _P13 = (
    np.float32(value)
    for value in (
        4.89352455891786e-03,
        6.37261928875436e-04,
        1.48572235717979e-05,
        5.12229709037114e-08,
        -8.60467152213735e-11,
        2.00018790482477e-13,
        -2.76076847742355e-16,
    )
)
_Q0, _Q2, _Q4, _Q6 = (
    np.float32(value)
    for value in (4.89352518554385e-03, 2.26843463243900e-03, 1.18534705686654e-04, 1.19825839466702e-06)
)


class Layer(NamedTuple):
    """Weights of a GRU layer, by source; the columns are the gates r, z and the candidate n."""

    w_ih: Floats  #: input weights, shape (in, 3 units)
    w_hh: Floats  #: recurrent weights, shape (units, 3 units)
    b_ih: Floats  #: biases of the input, shape (3 units,)
    b_hh: Floats  #: biases of the state, shape (3 units,)


class Readout(NamedTuple):
    """The linear output."""

    w_out: Floats  #: weights by source, shape (units, outputs)
    b_out: Floats  #: biases, shape (outputs,)


class Recurrent:
    """Att-RNN: two GRU layers and a linear output, in float32."""

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Lay the weights out for the kernel."""
        kinds = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
        names = [*(f"gru.{kind}_l{layer}" for layer in (0, 1) for kind in kinds), "out.weight", "out.bias"]
        by_source = {name: np.ascontiguousarray(tensors[name].T, np.float32) for name in names}
        scale = {"scale": np.array(config.output_scale)}
        self.network = packed(input_scaling(config.inputs)._asdict() | by_source | scale)
        self.outputs, self.state = config.n_outputs, state_type(config.encoding, config.hidden)
        self.kernel = run_gru


def state_type(h0: int, h1: int) -> np.dtype:
    """Record type of a copy's state: that of its encoder, and of the two layers."""
    return block_type({"encoder": (ENCODER, ()), "h0": (np.float32, (h0,)), "h1": (np.float32, (h1,))})


@njit(cache=True, inline="always", error_model="numpy", fastmath={"contract"})
def tanh(x):
    """Hyperbolic tangent in float32, to 3e-7 of its value.

    The rational function of Eigen (`generic_fast_tanh_float`), degrees 13 and 6: unlike the C library's, the
    compiler computes it for many numbers at once.
    """
    x = min(max(x, -_TANH_ONE), _TANH_ONE)
    y = x * x
    p = ((((((_P13 * y + _P11) * y + _P9) * y + _P7) * y + _P5) * y + _P3) * y + _P1) * x
    return p / (((_Q6 * y + _Q4) * y + _Q2) * y + _Q0)


@njit(cache=True, inline="always")
def _sigmoid(x):
    return _HALF + _HALF * tanh(_HALF * x)


@njit(cache=True)
def _copy(source, target):
    for i in range(target.shape[0]):
        target[i] = source[i]


@njit(cache=True, fastmath={"contract"})
def _one_row(x, weight, out):
    """Add x weight to `out`, four inputs at a time."""
    fours = x.shape[0] - x.shape[0] % 4
    for k in range(0, fours, 4):
        x0, x1, x2, x3 = x[k], x[k + 1], x[k + 2], x[k + 3]
        w0, w1, w2, w3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        for i in range(out.shape[0]):
            out[i] = out[i] + x0 * w0[i] + x1 * w1[i] + x2 * w2[i] + x3 * w3[i]
    for k in range(fours, x.shape[0]):
        x0, w0 = x[k], weight[k]
        for i in range(out.shape[0]):
            out[i] += x0 * w0[i]


@njit(cache=True, fastmath={"contract"})
def _four_rows(x, weight, out):
    """The same for four rows, which load the weights once."""
    a, b, c, d = out[0], out[1], out[2], out[3]
    fours = x.shape[1] - x.shape[1] % 4
    for k in range(0, fours, 4):
        a0, a1, a2, a3 = x[0, k], x[0, k + 1], x[0, k + 2], x[0, k + 3]
        b0, b1, b2, b3 = x[1, k], x[1, k + 1], x[1, k + 2], x[1, k + 3]
        c0, c1, c2, c3 = x[2, k], x[2, k + 1], x[2, k + 2], x[2, k + 3]
        d0, d1, d2, d3 = x[3, k], x[3, k + 1], x[3, k + 2], x[3, k + 3]
        row0, row1, row2, row3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        for i in range(a.shape[0]):
            w0, w1, w2, w3 = row0[i], row1[i], row2[i], row3[i]
            a[i] = a[i] + a0 * w0 + a1 * w1 + a2 * w2 + a3 * w3
            b[i] = b[i] + b0 * w0 + b1 * w1 + b2 * w2 + b3 * w3
            c[i] = c[i] + c0 * w0 + c1 * w1 + c2 * w2 + c3 * w3
            d[i] = d[i] + d0 * w0 + d1 * w1 + d2 * w2 + d3 * w3
    for k in range(fours, x.shape[1]):
        a0, b0, c0, d0, row0 = x[0, k], x[1, k], x[2, k], x[3, k], weight[k]
        for i in range(a.shape[0]):
            a[i] += a0 * row0[i]
            b[i] += b0 * row0[i]
            c[i] += c0 * row0[i]
            d[i] += d0 * row0[i]


@njit(cache=True, fastmath={"contract"})
def _affine(x, weight, bias, out):
    """Write bias + x weight, of rows x (rows, in) and a weight (in, columns), into `out` (rows, columns)."""
    for row in range(x.shape[0]):
        _copy(bias, out[row])
    fours = x.shape[0] - x.shape[0] % 4
    for row in range(0, fours, 4):
        _four_rows(x[row : row + 4], weight, out[row : row + 4])
    for row in range(fours, x.shape[0]):
        _one_row(x[row], weight, out[row])


@njit(cache=True, inline="always")
def _gates(from_x, from_h, h):
    """Replace the state h of one copy, given the two products."""
    units = h.shape[0]
    r_x, z_x, n_x = from_x[:units], from_x[units : 2 * units], from_x[2 * units :]
    r_h, z_h, n_h = from_h[:units], from_h[units : 2 * units], from_h[2 * units :]
    for i in range(units):
        r, z = _sigmoid(r_x[i] + r_h[i]), _sigmoid(z_x[i] + z_h[i])
        n = tanh(n_x[i] + r * n_h[i])
        h[i] = n + z * (h[i] - n)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _run_layer(x, h, layer):
    """Run a layer over some samples of some copies.

    Args:
        x: Inputs, those of all copies' first samples first, shape (samples · copies, in).
        h: States of the copies, changed, shape (copies, units).
        layer: Weights.

    Returns:
        The states after each sample, in the order of x, shape (samples · copies, units).
    """
    rows, copies, units = x.shape[0], h.shape[0], h.shape[1]
    y, from_x = np.empty((rows, units), np.float32), np.empty((rows, 3 * units), np.float32)
    from_h = np.empty((copies, 3 * units), np.float32)
    _affine(x, layer.w_ih, layer.b_ih, from_x)
    for row in range(0, rows, copies):
        _affine(h, layer.w_hh, layer.b_hh, from_h)
        for c in range(copies):
            _gates(from_x[row + c], from_h[c], h[c])
            _copy(h[c], y[row + c])
    return y


@njit(cache=True)
def _network(block):
    f = np.float32
    w_ih, w_hh = matrix(block, 2, f), matrix(block, 3, f)
    first = Layer(w_ih, w_hh, vector(block, 4, f), vector(block, 5, f))
    w_ih, w_hh = matrix(block, 6, f), matrix(block, 7, f)
    second = Layer(w_ih, w_hh, vector(block, 8, f), vector(block, 9, f))
    return first, second, Readout(matrix(block, 10, f), vector(block, 11, f))


@njit(cache=True)
def _encode(gyro, accel, scaling, states, x):
    """Scale the samples of some copies, (copies, 3 samples) each, into x, in the order of `_run_layer`."""
    copies = states.shape[0]
    for c in range(copies):
        encoder = vector(states[c], 0, ENCODER)[0]
        for t in range(gyro.shape[1] // 3):
            encode_sample(gyro[c, 3 * t : 3 * t + 3], accel[c, 3 * t : 3 * t + 3], scaling, encoder)
            for k in range(6):
                x[t * copies + c, k] = encoder.inputs[k] / INPUT_ONE


@njit(cache=True, nogil=True)
def run_gru(gyro, accel, set_points, network, states, out):
    """Run n copies over whole sequences, or one sample, from and to their states.

    Args:
        gyro: Body rate, one sample after the other, shape (n, 3 T) [rad/s].
        accel: Specific force, the same shape [m/s²].
        set_points: Not read.
        network: The scaling of the readings, both layers, the readout and the scale of the output, packed.
        states: Blocks of `state_type`, shape (n, words); changed.
        out: Outputs after each sample, shape (n, outputs T); written.
    """
    scaling = Scaling(vector(network, 0, np.float64), vector(network, 1, np.float64))
    first, second, readout = _network(network)
    steps, scale = gyro.shape[1] // 3, vector(network, 12, np.float64)[0]
    together = max(1, min(COPIES, states.shape[0]))
    samples = max(1, min(ROWS // together, steps))
    size = readout.b_out.shape[0]
    inputs = np.empty((samples * together, 6), np.float32)
    outputs = np.empty((samples * together, size), np.float32)
    h0 = np.empty((together, first.w_hh.shape[0]), np.float32)
    h1 = np.empty((together, second.w_hh.shape[0]), np.float32)
    for n in range(0, states.shape[0], together):
        group = states[n : n + together]
        copies = group.shape[0]
        for c in range(copies):
            _copy(vector(group[c], 1, np.float32), h0[c])
            _copy(vector(group[c], 2, np.float32), h1[c])
        for begin in range(0, steps, samples):
            end = min(begin + samples, steps)
            x, y_out = inputs[: (end - begin) * copies], outputs[: (end - begin) * copies]
            part = slice(3 * begin, 3 * end)
            _encode(gyro[n : n + copies, part], accel[n : n + copies, part], scaling, group, x)
            y = _run_layer(_run_layer(x, h0[:copies], first), h1[:copies], second)
            _affine(y, readout.w_out, readout.b_out, y_out)
            for row in range(x.shape[0]):
                c, t = row % copies, begin + row // copies
                for o in range(size):
                    out[n + c, size * t + o] = y_out[row, o] * scale
        for c in range(copies):
            _copy(h0[c], vector(group[c], 1, np.float32))
            _copy(h1[c], vector(group[c], 2, np.float32))
