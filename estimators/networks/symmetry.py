"""The symmetry of a quadrotor, built into the network: weights that turns and mirror images share.

Neither gravity, drag nor thrust changes when the body axes turn by a quarter about z or when y is reflected.
These eight operations, the dihedral group D4, permute the six inputs and the outputs up to their signs. A
network in which they permute the neurons as well, with equal weights wherever they map one connection onto
another, is equivariant: turned readings give the turned outputs, to the last bit (Cohen & Welling 2016,
"Group equivariant convolutional networks"). Each of its weights learns from eight times the data.

Up turns like that at every attitude. Roll and pitch do for small tilts only: at (30°, 30°) a quarter turn
gives (33.7°, -25.7°), where the network answers (30°, -30°).

Neurons stand in groups of eight, each group permuted by the operations as they permute themselves; four of
the rest stand for the four axes ±x, ±y; what then remains answers to all operations alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .weights_file import AXES, EXPONENTS

Ints = NDArray[np.int64]
Signs = NDArray[np.float32]

TURN = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
"""Components in body axes that are turned by a quarter about z."""
MIRROR = np.diag([1, -1, 1])
"""Components after a reflection of y."""
OPERATIONS = np.array(
    [np.linalg.matrix_power(TURN, k) @ m for k in range(4) for m in (np.eye(3, dtype=int), MIRROR)]
)
"""The eight of D4: the identity first, then the mirror, the turn, the mirror and then the turn, ..."""


class WeightSharing(NamedTuple):
    """Entries of an array that are one weight: each is `sign` times the entry `first`."""

    first: Ints
    """Flat index of the first entry of the same weight, one for each entry."""
    sign: Signs
    """Its sign, one for each entry; 0 where an operation maps the weight onto minus itself: it must be 0."""

    def apply(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """The array with each weight as its first entry has it."""
        return (values.ravel()[self.first] * self.sign.astype(values.dtype)).reshape(values.shape)

    def mean(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """The array with each weight as the mean over its entries."""
        size = self.first.size
        totals = np.bincount(self.first, values.ravel() * self.sign, size)
        means = totals / np.maximum(np.bincount(self.first, minlength=size), 1)
        return (means[self.first] * self.sign).astype(values.dtype).reshape(values.shape)


def weight_sharing(encoding: int, hidden: int, outputs: int = 2) -> dict[str, WeightSharing]:
    """The sharing of each weight and time constant of Att-SNN that D4 leaves free; the outputs have none.

    Args:
        encoding: Neurons of the encoding layer.
        hidden: Neurons of the hidden layer.
        outputs: 2: roll and pitch; 3: the world's up in body axes.

    Returns:
        By the names of the tensors, for arrays of their shapes.
    """
    rates_forces = [_signed(_on_inputs(m)) for m in OPERATIONS]
    answers = [_signed(m if outputs == 3 else _on_roll_pitch(m)) for m in OPERATIONS]
    first, second = ([(_on_neurons(n, k), np.ones(n)) for k in range(8)] for n in (encoding, hidden))
    single = [(np.zeros(1, np.int64), np.ones(1))] * 8
    actions = {"inputs": rates_forces, "encoding": first, "hidden": second, "outputs": answers, "one": single}
    return {
        name: _sharing(*(actions[axis] for axis in (*axes, "one")[:2]))
        for name, axes in AXES.items()
        if axes != ("one",)
    }


def is_symmetric(tensors: Mapping[str, NDArray]) -> bool:
    """Whether a network's tensors share their weights as D4 asks; those of a GRU do not."""
    if "w_in" not in tensors:
        return False
    shared = weight_sharing(*(len(tensors[name]) for name in ("w_in", "w_ff", "w_out")))
    shared |= {name: shared["mem1"] for name in EXPONENTS.values() if name in tensors}
    return all(
        np.array_equal(sharing.apply(tensors[name]), tensors[name])
        for name, sharing in shared.items()
        if name in tensors
    )


Action = tuple[Ints, NDArray[np.floating]]
"""Where each entry of a vector comes from, and its sign: (g y)[i] = sign[i] y[source[i]]."""


def _signed(matrix: NDArray) -> Action:
    """A signed permutation matrix as an action."""
    return np.abs(matrix).argmax(1), matrix.sum(1).astype(np.float64)


def _on_inputs(operation: NDArray[np.integer]) -> NDArray[np.float64]:
    """Body rates, a pseudovector, and specific forces, a vector."""
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = round(np.linalg.det(operation)) * operation, operation
    return whole


def _on_roll_pitch(operation: NDArray[np.integer]) -> NDArray[np.integer]:
    """Roll and pitch, for small angles the components y and -x of the world's up."""
    to_roll_pitch = np.array([[0, 1], [-1, 0]])
    return to_roll_pitch @ operation[:2, :2] @ to_roll_pitch.T


def _on_neurons(n: int, operation: int) -> Ints:
    """Where each neuron's activity comes from."""
    inverse = OPERATIONS[operation].T
    to = np.array([int(np.flatnonzero((inverse @ m == OPERATIONS).all((1, 2)))[0]) for m in OPERATIONS])
    eights, rest = n - n % 8, n % 8
    source = np.arange(n)
    source[:eights] = (np.arange(0, eights, 8)[:, None] + to).ravel()
    if rest >= 4:  # a quarter turn of the mirror's axis: operations 2 k and 2 k + 1 do the same
        source[eights : eights + 4] = eights + to[::2] // 2
    return source


def _sharing(rows: list[Action], columns: list[Action]) -> WeightSharing:
    width = columns[0][0].size
    both = list(zip(rows, columns, strict=True))
    entries = np.array([(row[:, None] * width + column).ravel() for (row, _), (column, _) in both])
    signs = np.array([np.outer(row, column).ravel() for (_, row), (_, column) in both])
    first = entries.min(0)
    towards = entries == first
    sign = signs[towards.argmax(0), np.arange(first.size)]
    torn = (towards & (signs != sign)).any(0)  # an operation that maps the entry onto minus itself
    return WeightSharing(first, np.where(torn, 0.0, sign).astype(np.float32))
