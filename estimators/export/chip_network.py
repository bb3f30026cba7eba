"""Conversion of a chain of layers from floats to the chip's integers.

A layer has one scale, the number of state units of 1.0. It is the largest scale at which weights, thresholds
and biases fit, and at which sums, currents and potentials of a run in floats leave a margin of `MARGIN`.

Inputs that are not spikes are encoded as in Att-SNN (`estimators.networks.forward.advance_encoders`): the
host computes the currents of the first layer, which reach the neurons as biases.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..loihi.layers import BIAS_EXP_MAX, WEIGHT_EXP_MIN, WEIGHT_MAX, WEIGHT_MIN, LoihiLayer
from ..loihi.neurons import BIAS_MANT_MAX, STATE_MAX, VTH_EXP, VTH_MAX
from ..networks.encoder import INPUT_MAX
from ..networks.forward import BIAS_EXP
from ..networks.layer_parameters import DECAY
from .nir_layers import Array, FloatLayer

Ints = NDArray[np.int64]
SUM_MAX = (1 << 21) - 1
"""Largest sum of the weights that arrive in a step [state units]."""
MARGIN = 4.0
"""Margin above the peaks of a run in floats, because other inputs may exceed them and sums wrap on
overflow."""

DRIVE_MAX = BIAS_MANT_MAX << BIAS_EXP
"""Largest bias with which the host drives a neuron [state units]; larger ones are clipped."""


class Peaks(NamedTuple):
    """Largest magnitudes in a run of a layer in floats."""

    arriving: float  #: of what enters the current in a step
    u: float  #: of the current
    v: float  #: of the potential


class ChipNetwork(NamedTuple):
    """A chain of layers for `LoihiNetwork`."""

    layers: list[LoihiLayer]
    ones: list[float]
    """State units of 1.0 in each layer."""
    encoders: Ints | None
    """For encoded inputs, weights of each input and, in the last row, of a constant 1, (inputs + 1, out), in
    steps of 64 state units."""


def quantise(
    layers: Sequence[FloatLayer], peaks: Sequence[Peaks], drive: float | None = None, one: float | None = None
) -> ChipNetwork:
    """Round a network to the chip's integers.

    Args:
        layers: From the input to the output.
        peaks: Peaks of each layer.
        drive: Largest current of encoded inputs; None if the inputs are spikes.
        one: State units of 1.0 in every layer; None chooses a scale for each layer.

    Raises:
        ValueError: The given scale does not fit a layer.
    """
    whole, ones, encoders = [], [], None
    for layer, peak in zip(layers, peaks, strict=True):
        encoded = drive is not None and not whole
        bias = layer.bias / (1.0 - layer.syn)  # that of a current that has settled
        scale = one or _one(layer, peak, bias, drive if encoded else None)
        step = scale / (1 << VTH_EXP)
        given: dict[str, object] = {
            "du": np.maximum(np.rint(DECAY.whole(layer.syn)), DECAY.low),
            "dv": np.rint(DECAY.whole(layer.mem)),
            "vth": np.minimum(np.rint(layer.vth * step), VTH_MAX),
        }
        if encoded:
            encoders = np.rint(np.vstack([layer.w_in.T, layer.bias]) * step).astype(np.int64)
            given |= {"w_in": None, "bias_exp": BIAS_EXP}
        else:
            given["w_in"], given["exp_in"] = mantissas(layer.w_in * step)
            given["bias_exp"] = exponents = _exponents(bias * scale, BIAS_MANT_MAX, 0, BIAS_EXP_MAX)
            given["bias_mant"] = np.rint(bias * scale / np.exp2(exponents))
        if layer.w_rec.any():
            given["w_rec"], given["exp_rec"] = mantissas(layer.w_rec * step)
        try:
            whole.append(LoihiLayer(**given))  # pyright: ignore[reportArgumentType]
        except ValueError as error:
            raise ValueError(f'node "{layer.name}": {error}') from error
        ones.append(scale)
    return ChipNetwork(whole, ones, encoders)


def _one(layer: FloatLayer, peak: Peaks, bias: Array, drive: float | None) -> float:
    """Return the scale of a layer."""
    largest_in = np.abs(layer.w_in).max()
    bounds = [
        (STATE_MAX, MARGIN * max(peak.u, peak.v)),
        (SUM_MAX, MARGIN * peak.arriving),
        ((VTH_MAX - 1) << VTH_EXP, np.max(layer.vth, where=np.isfinite(layer.vth), initial=0.0)),
        (WEIGHT_MAX << VTH_EXP, np.abs(layer.w_rec).max()),
    ]
    if drive is None:
        bounds += [(WEIGHT_MAX << VTH_EXP, largest_in), (BIAS_MANT_MAX << BIAS_EXP_MAX, np.abs(bias).max())]
    else:
        bounds += [(INPUT_MAX << VTH_EXP, max(largest_in, np.abs(layer.bias).max())), (DRIVE_MAX, drive)]
    return float(min([STATE_MAX, *(limit / size for limit, size in bounds if size)]))


def mantissas(weights: Array) -> tuple[Ints, Ints]:
    """Return even mantissas and the exponent of each row, for weights in steps of 2^0."""
    exponents = _exponents(np.abs(weights).max(1), WEIGHT_MAX, WEIGHT_EXP_MIN, 0)
    whole = 2 * np.rint(weights * np.exp2(-exponents - 1.0)[:, None])
    return np.clip(whole, WEIGHT_MIN, WEIGHT_MAX).astype(np.int64), exponents


def _exponents(sizes: Array, largest: int, low: int, high: int) -> Ints:
    """Return the smallest exponents with which mantissas can represent the numbers."""
    least = np.ceil(np.log2(np.maximum(np.abs(sizes), 1e-9) / largest))
    return np.clip(least, low, high).astype(np.int64)
