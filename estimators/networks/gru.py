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

from quadsim.runs.compiled import njit

from .encoder import INPUT_ONE, MISSING, Scaling, encode_sample, encoder_fields, input_scaling
from .weights_file import READINGS, NetworkConfig, Tensors

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


class Recurrent:
    """Att-RNN: two GRU layers and a linear output, in float32; a `NetworkCore`."""

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Lay the weights out for the kernel: by source, biases in the last rows."""
        kinds = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
        parts = [[f"gru.{kind}_l{layer}" for kind in kinds] for layer in (0, 1)]
        parts.append(["out.weight", "out.bias"])
        matrices = [np.concatenate([np.atleast_2d(tensors[name].T) for name in names]) for names in parts]
        settings = np.array([*np.ravel(input_scaling(config.inputs)), config.output_scale])
        self.arrays = settings, *(np.ascontiguousarray(each, np.float32) for each in matrices)
        sizes = (("h0", config.encoding), ("h1", config.hidden))
        layers = ((name, np.float64, size) for name, size in sizes)
        self.outputs, self.state = config.n_outputs, np.dtype([*encoder_fields(np.float64), *layers])
        self.kernel = run_gru


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


@njit(inline="always")
def _sigmoid(x):
    return _HALF + _HALF * tanh(_HALF * x)


@njit
def _copy(source, target):
    for i in range(target.shape[0]):
        target[i] = source[i]


@njit(fastmath={"contract"})
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


@njit(fastmath={"contract"})
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


@njit(fastmath={"contract"})
def _affine(x, weight, bias, out):
    """Write bias + x weight, of rows x (rows, in) and a weight (in, columns), into `out` (rows, columns)."""
    for row in range(x.shape[0]):
        _copy(bias, out[row])
    fours = x.shape[0] - x.shape[0] % 4
    for row in range(0, fours, 4):
        _four_rows(x[row : row + 4], weight, out[row : row + 4])
    for row in range(fours, x.shape[0]):
        _one_row(x[row], weight, out[row])


@njit(inline="always")
def _gates(from_x, from_h, h):
    """Replace the state h of one copy, given the two products."""
    units = h.shape[0]
    r_x, z_x, n_x = from_x[:units], from_x[units : 2 * units], from_x[2 * units :]
    r_h, z_h, n_h = from_h[:units], from_h[units : 2 * units], from_h[2 * units :]
    for i in range(units):
        r, z = _sigmoid(r_x[i] + r_h[i]), _sigmoid(z_x[i] + z_h[i])
        n = tanh(n_x[i] + r * n_h[i])
        h[i] = n + z * (h[i] - n)


@njit(error_model="numpy", fastmath={"contract"})
def _run_layer(x, h, layer):
    """States after inputs x, (samples · copies, ..), the first samples of all copies first; h is changed."""
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


@njit(inline="always")
def _layer(rows):
    """The layer whose weights and biases are rows of a matrix."""
    biases = rows.shape[0] - 2
    inputs = biases - rows.shape[1] // 3
    return Layer(rows[:inputs], rows[inputs:biases], rows[biases], rows[biases + 1])


@njit
def _encode(gyro, accel, scaling, states, x):
    """Scale the samples of some copies, (copies, 3 samples) each, into x, in the order of `_run_layer`."""
    copies = states.shape[0]
    for c in range(copies):
        for t in range(gyro.shape[1] // 3):
            encode_sample(gyro[c, 3 * t : 3 * t + 3], accel[c, 3 * t : 3 * t + 3], scaling, states[c])
            for k in range(READINGS):
                x[t * copies + c, k] = states[c, k] / INPUT_ONE


@njit(cache=True, nogil=True)
def run_gru(gyro, accel, set_points, settings, first_rows, second_rows, readout, states, out):
    """Run n copies over whole sequences, or one sample, from and to their states.

    Args:
        gyro: Body rate, one sample after the other, shape (n, 3 T) [rad/s].
        accel: Specific force, the same shape [m/s²].
        set_points: Not read.
        settings: The scaling of the readings, (12,), and the scale of the output.
        first_rows: Weights and biases of a layer by source, (in + units + 2, 3 units).
        second_rows: The same of the second.
        readout: Weights by source and biases of the output, (units + 1, outputs).
        states: Numbers of records of `Recurrent.state`, shape (n, words); changed.
        out: Outputs after each sample, shape (n, outputs T); written.
    """
    scaling, scale = Scaling(settings[:READINGS], settings[READINGS:12]), settings[12]
    first, second = _layer(first_rows), _layer(second_rows)
    units, size = readout.shape[0] - 1, readout.shape[1]
    steps, together = gyro.shape[1] // 3, max(1, min(COPIES, states.shape[0]))
    samples = max(1, min(ROWS // together, steps))
    inputs = np.empty((samples * together, READINGS), np.float32)
    outputs = np.empty((samples * together, size), np.float32)
    h0 = np.empty((together, first.w_hh.shape[0]), np.float32)
    h1 = np.empty((together, units), np.float32)
    begin0, begin1 = MISSING + 1, MISSING + 1 + h0.shape[1]
    for n in range(0, states.shape[0], together):
        group = states[n : n + together]
        copies = group.shape[0]
        for c in range(copies):
            _copy(group[c, begin0:begin1], h0[c])
            _copy(group[c, begin1:], h1[c])
        for begin in range(0, steps, samples):
            end = min(begin + samples, steps)
            x, y_out = inputs[: (end - begin) * copies], outputs[: (end - begin) * copies]
            part = slice(3 * begin, 3 * end)
            _encode(gyro[n : n + copies, part], accel[n : n + copies, part], scaling, group, x)
            y = _run_layer(_run_layer(x, h0[:copies], first), h1[:copies], second)
            _affine(y, readout[:units], readout[units], y_out)
            for row in range(x.shape[0]):
                c, t = row % copies, begin + row // copies
                for o in range(size):
                    out[n + c, size * t + o] = y_out[row, o] * scale
        for c in range(copies):
            _copy(h0[c], group[c, begin0:begin1])
            _copy(h1[c], group[c, begin1:])
