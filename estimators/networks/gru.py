"""Two GRU layers and a linear output, compiled; the equations of `torch.nn.GRU` (Cho et al. 2014).

    r = σ(W_ir x + b_ir + W_hr h + b_hr)
    z = σ(W_iz x + b_iz + W_hz h + b_hz)
    n = tanh(W_in x + b_in + r (W_hn h + b_hn))
    h ← (1 - z) n + z h

Sums are computed in the order of the inputs, with fused multiply-add (`fma`).
"""

from __future__ import annotations

import numpy as np

from quadsim.runs.compiled import njit

from .encoder import ENCODED, INPUT_ONE, Scaling, encode_sample, encoder_fields, input_scaling
from .weights_file import READINGS, NetworkConfig, Tensors

_HALF = np.float32(0.5)
_TANH_ONE = np.float32(7.90531110763549805)
"""Argument from which tanh is 1 in float32."""
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


class Recurrent:
    """Two GRU layers and a linear output in float32, a `NetworkCore`."""

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Arrange the weights for the kernel: by source, with each bias in the row after its weights."""
        kinds = ("weight_ih", "bias_ih", "weight_hh", "bias_hh")
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
    """Compute the hyperbolic tangent in float32, with a relative error of 3e-7.

    The function is Eigen's rational approximation (`generic_fast_tanh_float`) of degrees 13 and 6, which the
    compiler can vectorise.
    """
    x = min(max(x, -_TANH_ONE), _TANH_ONE)
    y = x * x
    p = ((((((_P13 * y + _P11) * y + _P9) * y + _P7) * y + _P5) * y + _P3) * y + _P1) * x
    return p / (((_Q6 * y + _Q4) * y + _Q2) * y + _Q0)


@njit(inline="always")
def _sigmoid(x):
    return _HALF + _HALF * tanh(_HALF * x)


@njit(fastmath={"contract"})
def _affine(x, rows, out):
    """Write bias + x weight to `out`; the rows of the matrix are weights by source and the bias."""
    bias = rows[x.size]
    for i in range(out.size):
        out[i] = bias[i]
    for k in range(x.size):
        sample, weight = x[k], rows[k]
        for i in range(out.size):
            out[i] += sample * weight[i]


@njit(error_model="numpy", fastmath={"contract"})
def _advance(x, h, rows, from_x, from_h):
    """Advance the state h of a layer by an input x; the last arguments are temporary storage."""
    units = h.size
    _affine(x, rows, from_x)
    _affine(h, rows[x.size + 1 :], from_h)
    for i in range(units):
        r, z = _sigmoid(from_x[i] + from_h[i]), _sigmoid(from_x[units + i] + from_h[units + i])
        n = tanh(from_x[2 * units + i] + r * from_h[2 * units + i])
        h[i] = n + z * (h[i] - n)


@njit(cache=True, nogil=True)
def run_gru(gyro, accel, set_points, settings, first, second, readout, states, out):
    """Run n copies over sequences and update their states, with the signature of `NetworkCore.kernel`.

    Args:
        gyro: Body rate, sample after sample, shape (n, 3 T) [rad/s].
        accel: Specific force, same shape [m/s²].
        set_points: Not read.
        settings: The scaling of the readings, (12,), and the scale of the output.
        first: Matrices of the first layer for `_affine`: for the input, then for the state.
        second: Matrices of the second layer.
        readout: Matrix of the output, (units + 1, outputs).
        states: Numbers of records of `Recurrent.state`, shape (n, words); changed.
        out: Outputs after each sample, shape (n, outputs T); written.
    """
    scaling, scale = Scaling(settings[:READINGS], settings[READINGS:12]), settings[12]
    h0, h1 = np.empty(first.shape[1] // 3, np.float32), np.empty(second.shape[1] // 3, np.float32)
    wide = 3 * max(h0.size, h1.size)
    from_x, from_h = np.empty(wide, np.float32), np.empty(wide, np.float32)
    x, y = np.empty(READINGS, np.float32), np.empty(readout.shape[1], np.float32)
    for c in range(states.shape[0]):
        inputs, kept0, kept1 = np.split(states[c], (ENCODED, ENCODED + h0.size))
        h0[:], h1[:] = kept0, kept1
        for t in range(gyro.shape[1] // 3):
            encode_sample(gyro[c, 3 * t : 3 * t + 3], accel[c, 3 * t : 3 * t + 3], scaling, inputs)
            for k in range(READINGS):
                x[k] = inputs[k] / INPUT_ONE
            _advance(x, h0, first, from_x[: 3 * h0.size], from_h[: 3 * h0.size])
            _advance(h0, h1, second, from_x[: 3 * h1.size], from_h[: 3 * h1.size])
            _affine(h1, readout, y)
            for o in range(y.size):
                out[c, y.size * t + o] = y[o] * scale
        kept0[:], kept1[:] = h0, h1
