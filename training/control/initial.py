"""The first network of a controller: on its own, or on the spikes of an attitude estimator that stays.

A controller on an estimator is one network for the chip. The neurons of the estimator come first in both
layers and have connections among themselves alone. The controller's encoding neurons read gyroscope and
set-points, its hidden neurons these and the hidden spikes of the estimator. The outputs read the controller's
hidden neurons:

    w_in = [E 0; c 0 c]    w_ff = [E 0; 0 c]    w_rec = [E 0; c c]    w_out = [0 c]

with E the estimator's weights and c what is trained.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.networks.network import real_weights
from estimators.networks.weights_file import READINGS, SET_POINTS

from ..config import TrainConfig, estimator_weights
from ..init import (
    AFTER_SPIKE,
    TAU_LIMITS,
    drive_scale,
    filtered,
    initialise_taus,
    layer_spikes,
    random_encoders,
    read_some,
    solve_outputs,
    sparse_recurrence,
)
from ..models import AttSNN

Array = NDArray[np.float64]
TAUS = {
    "syn0": (0.5, 2.0),
    "mem0": (1.0, 60.0),
    "syn1": (0.5, 100.0),
    "mem1": (1.0, 100.0),
    "syn2": (0.5, 0.5),
    "mem2": (1.5, 1.5),
    "syn_after": (1.0, 100.0),
}
"""Ranges of the controller's time constants at first, log-uniform [steps]: the slowest hold an integral."""
CODER_TAU = 0.6
"""Of the membranes of hidden neurons whose currents are at first the estimate, turned and scaled."""


class GivenEstimator(NamedTuple):
    """The part of a network that does not change."""

    sizes: tuple[int, int] = (0, 0)
    """Its encoding and hidden neurons; 0 without one."""
    values: dict[str, Array] = {}  # noqa: RUF012  (never changed)
    """Its weights and time constants by name, in units of 1.0, but for the readout's."""
    readout: Array = np.zeros((2, 0))
    """Output weights of roll and pitch, or of up's x and y, (2, hidden)."""
    memory: float = 0.0
    """Time constant of its outputs."""


def given_estimator(config: TrainConfig) -> GivenEstimator:
    """The estimator in front of a controller, if there is one."""
    if not config.control.estimator:
        return GivenEstimator()
    network, tensors = estimator_weights(config.control.estimator)
    values = real_weights(network, tensors)._asdict()
    used = {
        name: value for name, value in values.items() if value.size and name not in ("w_out", "syn2", "mem2")
    }
    sizes = network.encoding, network.hidden
    return GivenEstimator(sizes, used, values["w_out"][:2], float(values["mem2"][0]))


def connect(model: AttSNN, sizes: tuple[int, int]) -> None:
    """Leave the connections alone that a controller on an estimator of these sizes has."""
    e0, e1 = sizes
    allowed = {name: getattr(model, f"{name}_connected") for name in ("w_in", "w_ff", "w_rec", "w_out")}
    allowed["w_in"][:e0, READINGS:] = False
    allowed["w_in"][e0:, SET_POINTS:READINGS] = False  # the estimator alone reads the accelerometer
    allowed["w_ff"][:e1, e0:] = allowed["w_ff"][e1:, :e0] = False
    allowed["w_rec"][:e1, e1:] = False
    allowed["w_out"][:, :e1] = False


def initialise(
    model: AttSNN, estimator: GivenEstimator, x: Array, target: NDArray[np.floating], seed: int
) -> None:
    """Solve, not train: random features of the inputs and of the estimator's spikes, outputs by regression.

    As `training.init.initialise_from_data`, with other time constants. On an estimator, the currents of half
    of the hidden neurons are its estimate, filtered as its own outputs filter it.

    Args:
        model: To fill.
        estimator: Its part that is given, and stays.
        x: Scaled inputs, (n, T, 9).
        target: Of the outputs, (n, T, 3) [rad/s²].
        seed: Of what is random.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    (e0, e1), (h1, h0) = estimator.sizes, model.w_ff.shape
    if e0:
        connect(model, estimator.sizes)
    initialise_taus(model, TAUS, rng)
    values = {name: np.zeros(getattr(model, name).shape) for name in model.matrices}
    for name, value in estimator.values.items():
        if name in values:
            values[name][tuple(slice(0, size) for size in value.shape)] = value
        else:
            model.set_taus(name, np.clip(value, *TAU_LIMITS), slice(0, len(value)))
    inputs = np.flatnonzero(model.get_buffer("w_in_connected")[-1].numpy())
    tau = model.tau("syn0").detach().numpy()[e0:]
    values["w_in"][e0:, inputs] = random_encoders(np.ascontiguousarray(x[..., inputs]), tau, inputs.size, rng)
    if "w_after" in values:
        values["w_after"][e1:] = AFTER_SPIKE
    for name, value in values.items():
        model.set_weights(name, value)
    model.constrain()
    first, second = layer_spikes(model, x)
    features = np.concatenate([first[..., e0:], second[..., :e1]], 2)
    w = np.zeros((h1 - e1, features.shape[2]))
    for row in w:
        for part in (np.arange(h0 - e0), np.arange(h0 - e0, features.shape[2])):
            read_some(row, part, rng)
    coders = (h1 - e1) // 2 if e1 else 0
    w[:coders, : h0 - e0] = 0.0
    w[:coders, h0 - e0 :] = rng.normal(size=(coders, 2)) @ estimator.readout
    for name, memory in (("syn1", estimator.memory), ("mem1", CODER_TAU)):
        model.set_taus(name, np.full(coders, memory), slice(e1, e1 + coders))
    current = filtered(features @ w.T, model.tau("syn1").detach().numpy()[e1:])
    w *= drive_scale(current, (0.2, 1.0), rng)[:, None]
    values["w_ff"][e1:, e0:], values["w_rec"][e1:, :e1] = w[:, : h0 - e0], w[:, h0 - e0 :]
    values["w_rec"][e1:, e1:] = sparse_recurrence(h1 - e1, rng)
    model.set_weights("w_ff", values["w_ff"])
    model.set_weights("w_rec", values["w_rec"])
    model.constrain()
    values["w_out"][:, e1:] = solve_outputs(model, x, target, e1)
    model.set_weights("w_out", values["w_out"])
    model.constrain()
    model.freeze(e0, e1)
