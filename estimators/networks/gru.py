"""Two GRU layers and a linear output, compiled; the equations of `torch.nn.GRU` (Cho et al. 2014)."""

from __future__ import annotations

import math

import numpy as np

from quadsim.runs.compiled import njit


@njit(cache=True)
def _affine(x, weight, bias, out):
    """Write bias + x weight into `out`, four rows of the weight (in, out) at a time."""
    out[:] = bias
    whole = x.shape[0] - x.shape[0] % 4
    for k in range(0, whole, 4):
        x0, x1, x2, x3 = x[k], x[k + 1], x[k + 2], x[k + 3]
        for i in range(out.shape[0]):
            out[i] += (x0 * weight[k, i] + x1 * weight[k + 1, i]) + (
                x2 * weight[k + 2, i] + x3 * weight[k + 3, i]
            )
    for k in range(whole, x.shape[0]):
        value = x[k]
        for i in range(out.shape[0]):
            out[i] += value * weight[k, i]


@njit(cache=True)
def _gru_step(x, w_ih, w_hh, b_ih, b_hh, h, from_x, from_h):
    """Replace h by (1 - z) n + z h with the reset and update gates r, z and the candidate n."""
    _affine(x, w_ih, b_ih, from_x)
    _affine(h, w_hh, b_hh, from_h)
    units, one = h.shape[0], np.float32(1.0)
    for i in range(units):
        r = one / (one + math.exp(-(from_x[i] + from_h[i])))
        z = one / (one + math.exp(-(from_x[units + i] + from_h[units + i])))
        n = math.tanh(from_x[2 * units + i] + r * from_h[2 * units + i])
        h[i] = (one - z) * n + z * h[i]


@njit(cache=True)
def run_gru(x, weights, readout, h0, h1, out):
    """Run n copies over sequences from and to their states.

    Args:
        x: Inputs, shape (n, T, inputs), float32.
        weights: For both layers W_ih (in, 3 units), W_hh (units, 3 units), b_ih, b_hh; gates r, z, n.
        readout: Output weights (outputs, units) and biases (outputs,).
        h0: State of the first layer, shape (n, units); changed.
        h1: State of the second layer, shape (n, units); changed.
        out: Outputs, shape (n, T, outputs); written.
    """
    w_ih0, w_hh0, b_ih0, b_hh0, w_ih1, w_hh1, b_ih1, b_hh1 = weights
    w_out, b_out = readout
    from_x, from_h = np.empty((2, 3 * h0.shape[1]), np.float32)
    from_x1, from_h1 = np.empty((2, 3 * h1.shape[1]), np.float32)
    for n in range(x.shape[0]):
        for t in range(x.shape[1]):
            _gru_step(x[n, t], w_ih0, w_hh0, b_ih0, b_hh0, h0[n], from_x, from_h)
            _gru_step(h0[n], w_ih1, w_hh1, b_ih1, b_hh1, h1[n], from_x1, from_h1)
            for o in range(out.shape[2]):
                total = b_out[o]
                for i in range(h1.shape[1]):
                    total += h1[n, i] * w_out[o, i]
                out[n, t, o] = total
