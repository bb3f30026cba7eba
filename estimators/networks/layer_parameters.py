"""Parameters of Att-SNN's synapses and neurons: a table for files, chip, training and exports.

To add a parameter, add a row to `PARAMETERS` and, if the kernels need it in units of 1.0, a field to
`Weights`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..loihi.layers import WEIGHT_EXP_MIN, WEIGHT_MAX, WEIGHT_MIN
from ..loihi.neurons import DECAY_ONE

Values = TypeVar("Values")


class Kind(NamedTuple):
    """Conversion of whole numbers on the chip and in files to units of 1.0: zero + slope × number."""

    low: int  #: smallest number
    high: int  #: largest number
    slope: float
    zero: float
    in_c: Callable[[Any], Any]
    """Number in the C code instead of the number in the file."""

    @property
    def step(self) -> float:
        """Difference between two neighbouring values in units of 1.0."""
        return abs(self.slope)

    def real(self, whole: Any) -> Any:
        """Convert whole numbers, arrays or tensors to units of 1.0."""
        return self.zero + self.slope * whole

    def whole(self, real: Any) -> Any:
        """Convert values in units of 1.0 to numbers, without rounding."""
        return (real - self.zero) / self.slope


WEIGHT = Kind(WEIGHT_MIN, WEIGHT_MAX, 1 / 256, 0.0, lambda mantissa: mantissa // 2)
"""Even mantissas, which are multiplied by 2 to the power of the exponent of the row."""
DECAY = Kind(1, DECAY_ONE, -1 / DECAY_ONE, 1.0, lambda decay: (DECAY_ONE - decay) << 19)
"""Decays, whose values in units of 1.0 are time constants τ."""
EXPONENT = Kind(WEIGHT_EXP_MIN, 0, 1.0, 0.0, lambda exponent: 1 << (7 + exponent))


class LayerParameter(NamedTuple):
    """One tensor of the network."""

    layer: str
    """Layer of the neurons with this parameter: encoding, hidden or outputs."""
    role: str
    """Corresponding argument of `LoihiLayer`."""
    kind: Kind
    axes: tuple[str, ...]
    """Meaning of rows and columns; "one" is a single number for the layer."""
    first: float = 0.0
    """Initial value, which is also that of files without the parameter and of the paper's published code."""
    optional: bool = False
    """Whether a file may omit the parameter."""


PARAMETERS = {
    "w_in": LayerParameter("encoding", "w_in", WEIGHT, ("encoding", "inputs")),
    "w_ff": LayerParameter("hidden", "w_in", WEIGHT, ("hidden", "encoding")),
    "w_rec": LayerParameter("hidden", "w_rec", WEIGHT, ("hidden", "hidden")),
    "w_out": LayerParameter("outputs", "w_in", WEIGHT, ("outputs", "hidden")),
    "syn0": LayerParameter("encoding", "du", DECAY, ("encoding",), 1 - 0.08),
    "mem0": LayerParameter("encoding", "dv", DECAY, ("encoding",), 1 - 0.03),
    "syn1": LayerParameter("hidden", "du", DECAY, ("hidden",), 1 - 0.08),
    "mem1": LayerParameter("hidden", "dv", DECAY, ("hidden",), 1 - 0.03),
    "syn2": LayerParameter("outputs", "du", DECAY, ("one",), 1 - 0.5),
    "mem2": LayerParameter("outputs", "dv", DECAY, ("one",), 1 - 0.08),
    "exp_ff": LayerParameter("hidden", "exp_in", EXPONENT, ("hidden",), optional=True),
    "exp_rec": LayerParameter("hidden", "exp_rec", EXPONENT, ("hidden",), optional=True),
}
"""Tensors of Att-SNN by their names in a file; only quantised networks have exponents."""
EXPONENTS = {"w_ff": "exp_ff", "w_rec": "exp_rec"}
"""Name of the exponents of the weights into each hidden neuron, by the name of the weights."""
THRESHOLD = 0.5
THRESHOLDS = {"encoding": THRESHOLD, "hidden": THRESHOLD, "outputs": np.inf}
"""Thresholds of the neurons of each layer; the outputs never spike."""


class Weights(NamedTuple, Generic[Values]):
    """Parameters of the network, arrays or tensors, in units of 1.0."""

    w_in: Values  #: encoding weights, shape (h0, inputs)
    w_ff: Values  #: encoding to hidden layer, shape (h1, h0)
    w_rec: Values  #: recurrent weights, shape (h1, h1)
    w_out: Values  #: hidden layer to outputs, shape (outputs, h1)
    syn0: Values  #: τ_syn of the encoding layer, shape (h0,)
    mem0: Values  #: τ_mem of the encoding layer, shape (h0,)
    syn1: Values  #: τ_syn of the hidden layer, shape (h1,)
    mem1: Values  #: τ_mem of the hidden layer, shape (h1,)
    syn2: Values  #: τ_syn of the outputs, shape (1,)
    mem2: Values  #: τ_mem of the outputs, shape (1,)


MATRICES = tuple(name for name in Weights._fields if PARAMETERS[name].kind is WEIGHT)
NEURON_CONSTANTS = tuple(name for name in Weights._fields if name not in MATRICES)


def of_layer(values: Mapping[str, Values], layer: str) -> dict[str, Values]:
    """Return the values that belong to a layer, by role; the input is by the names of `PARAMETERS`."""
    mine = {name: each for name, each in PARAMETERS.items() if each.layer == layer}
    return {each.role: values[name] for name, each in mine.items() if name in values}


def complete(tensors: Mapping[str, NDArray[Any]], whole: bool = True) -> dict[str, NDArray[Any]]:
    """Return all tensors of a network; tensors that its file omits have their initial values."""
    sizes, found = {"encoding": len(tensors["w_in"]), "hidden": len(tensors["w_ff"])}, dict(tensors)
    for name, each in PARAMETERS.items():
        if each.optional and name not in tensors:
            first = round(each.kind.whole(each.first)) if whole else each.first
            found[name] = np.full(sizes[each.layer], first, np.int16 if whole else np.float64)
    return found
