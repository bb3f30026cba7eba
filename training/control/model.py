"""The network of a controller: on its own, or on the spikes of an attitude estimator that does not change.

A controller on an estimator is one network for the chip. The neurons of the estimator come first in both
layers and have connections among themselves alone. The controller's encoding neurons read gyroscope and
set-points, its hidden neurons these and the hidden spikes of the estimator. The outputs read the controller's
hidden neurons:

    w_in = [E 0; c 0 c]    w_ff = [E 0; 0 c]    w_rec = [E 0; c c]    w_out = [0 c]

with E the estimator's weights and c what is trained.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from estimators.networks.network import real_weights
from estimators.networks.weights_file import READINGS, SET_POINTS, NetworkConfig, Tensors

from ..fused import Fused
from ..init import AFTER_SPIKE, drive_scale, filtered, initialise_taus, layer_spikes, solve_outputs
from ..models import LAYERS, AttSNN
from .config import ControlConfig, read_estimator

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
FAN_IN = 25
"""Encoders, and neurons of the estimator, that each hidden neuron reads at first."""


class Estimator(NamedTuple):
    """The part of a network that does not change."""

    sizes: tuple[int, int]
    """Its encoding and hidden neurons; 0 without one."""
    values: dict[str, Array]
    """Its weights and time constants by name, in units of 1.0."""
    readout: Array
    """Output weights of roll and pitch, or of up's x and y, (2, hidden)."""
    memory: float
    """Time constant of its outputs."""

    def part(self, name: str) -> tuple[slice, ...]:
        """Where the values of a parameter stand within those of the whole network."""
        return tuple(slice(0, None if k is None else self.sizes[k]) for k in LAYERS[name])

    def rows(self, name: str) -> slice:
        """Rows of a parameter that belong to it, whatever they read."""
        layer = LAYERS[name][0]
        return slice(0, 0 if layer is None else self.sizes[layer])


def no_estimator() -> Estimator:
    """For a network that reads the IMU itself."""
    return Estimator((0, 0), {}, np.zeros((2, 0)), 0.0)


def estimator_of(config: ControlConfig) -> Estimator:
    """The estimator in front of a controller, if there is one."""
    if not config.estimator:
        return no_estimator()
    network, tensors = read_estimator(config.estimator)
    values = real_weights(network, tensors)._asdict()
    readout = ("w_out", "syn2", "mem2")
    used = {name: value for name, value in values.items() if value.size and name not in readout}
    sizes = network.encoding, network.hidden
    return Estimator(sizes, used, values["w_out"][:2], float(values["mem2"][0]))


def new_model(config: ControlConfig, estimator: Estimator) -> AttSNN:
    """The network with all its connections; without values, but for the estimator's."""
    learning, (e0, e1) = config.learning, estimator.sizes
    kernels = Fused(True, learning.recurrent_delay, config.threads)
    model = AttSNN(
        learning.encoding + e0,
        learning.hidden + e1,
        kernels,
        config.output_scale,
        outputs="angular-acceleration",
        finest_exponent=learning.finest_exponent,
        after_spike=learning.after_spike,
        parametrisation=learning.parametrisation,
    )
    if e0 and not config.end_to_end:
        allowed = {name: getattr(model, f"{name}_connected") for name in ("w_in", "w_ff", "w_rec", "w_out")}
        allowed["w_in"][:e0, READINGS:] = False
        allowed["w_in"][e0:, SET_POINTS:READINGS] = False  # the estimator alone reads the accelerometer
        allowed["w_ff"][:e1, e0:] = allowed["w_ff"][e1:, :e0] = False
        allowed["w_rec"][:e1, e1:] = False
        allowed["w_out"][:, :e1] = False
    return model


class Frozen:
    """Keeps the estimator's rows of a network: their gradients are 0, and `restore` undoes other changes.

    Args:
        model: The network, with the estimator's values in it.
        estimator: The part.
    """

    def __init__(self, model: AttSNN, estimator: Estimator) -> None:
        self.model = model
        self.rows = {name: estimator.rows(name) for name in (*model.matrices, *model.taus)}
        self.values = {
            name: getattr(model, name).detach()[rows].clone() for name, rows in self.rows.items() if rows.stop
        }
        for name in self.values:
            mask = torch.ones_like(getattr(model, name).detach())
            mask[self.rows[name]] = 0.0
            getattr(model, name).register_hook(lambda gradient, mask=mask: gradient * mask)

    @torch.no_grad()
    def restore(self) -> None:
        """Put the values back that constraints have changed."""
        for name, value in self.values.items():
            getattr(self.model, name)[self.rows[name]] = value


def initialise(
    model: AttSNN, estimator: Estimator, x: Array, target: NDArray[np.floating], seed: int
) -> None:
    """Solve, not train: random features of the inputs and of the estimator's spikes, outputs by regression.

    As `training.init.initialise_from_data`, with other time constants. On an estimator, the currents of half
    of the hidden neurons are its estimate, filtered as its own outputs filter it.

    Args:
        model: To fill.
        estimator: Its part that is given.
        x: Scaled inputs, (n, T, 9).
        target: Of the outputs, (n, T, 3) [rad/s²].
        seed: Of what is random.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    (e0, e1), (h1, h0) = estimator.sizes, model.w_ff.shape
    initialise_taus(model, TAUS, rng)
    values = {name: np.zeros(getattr(model, name).shape) for name in model.matrices}
    for name, value in estimator.values.items():
        if name in values:
            values[name][tuple(slice(0, size) for size in value.shape)] = value
        else:
            model.set_taus(name, np.clip(value, 1 / 1024, 4095 / 4096), slice(0, len(value)))
    inputs = np.flatnonzero(model.get_buffer("w_in_connected")[-1].numpy())
    rows, deviation = h0 - e0, np.maximum(x.reshape(-1, x.shape[-1]).std(0)[inputs], 1e-3)
    directions = rng.normal(size=(rows, inputs.size)) * (rng.random((rows, inputs.size)) < 0.3)
    every = np.arange(rows)
    directions[every, every % inputs.size] += np.where(every // inputs.size % 2 == 0, -2.0, 2.0)
    gain = np.exp(rng.uniform(math.log(0.05), math.log(0.5), (rows, 1)))
    tau = model.tau("syn0").detach().numpy()[e0:, None]
    size = np.linalg.norm(directions, axis=1, keepdims=True)
    values["w_in"][e0:, inputs] = directions / size / deviation * gain * (1 - tau)
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
            chosen = rng.choice(part, min(FAN_IN, part.size), replace=False)
            row[chosen] = rng.normal(size=chosen.size)
    coders = (h1 - e1) // 2 if e1 else 0
    w[:coders, : h0 - e0] = 0.0
    w[:coders, h0 - e0 :] = rng.normal(size=(coders, 2)) @ estimator.readout
    for name, tau in (("syn1", estimator.memory), ("mem1", CODER_TAU)):
        model.set_taus(name, np.full(coders, tau), slice(e1, e1 + coders))
    current = filtered(features @ w.T, model.tau("syn1").detach().numpy()[e1:])
    w *= drive_scale(current, (0.2, 1.0), rng)[:, None]
    values["w_ff"][e1:, e0:], values["w_rec"][e1:, :e1] = w[:, : h0 - e0], w[:, h0 - e0 :]
    among = rng.normal(size=(h1 - e1, h1 - e1)) * (rng.random((h1 - e1, h1 - e1)) < 0.1)
    values["w_rec"][e1:, e1:] = among * 0.02
    model.set_weights("w_ff", values["w_ff"])
    model.set_weights("w_rec", values["w_rec"])
    model.constrain()
    values["w_out"][:, e1:] = solve_outputs(model, x, target, e1)
    model.set_weights("w_out", values["w_out"])
    model.constrain()


def network_of(config: ControlConfig, model: AttSNN, rate_hz: float, note: dict[str, Any]) -> NetworkConfig:
    """How the network is run."""
    learning = config.learning
    return NetworkConfig(
        model="att-snn",
        rate_hz=rate_hz,
        encoding=model.w_in.shape[0],
        hidden=model.w_ff.shape[0],
        inputs=learning.inputs,
        quantised=True,
        recurrent_delay=learning.recurrent_delay,
        after_spike=learning.after_spike,
        steps_per_sample=learning.steps_per_sample,
        outputs="angular-acceleration",
        output_scale=config.output_scale,
        set_point=config.set_point,
        training=note,
    )


def estimator_within(tensors: Tensors, sizes: tuple[int, int], names: tuple[str, ...]) -> Tensors:
    """The estimator's tensors in those of a controller on it, all but its readout."""
    whole = {name: slice(0, sizes[0]) if name.endswith("0") else slice(0, sizes[1]) for name in names}
    cut = {name: tensors[name][rows] for name, rows in whole.items()}
    cut["w_in"] = tensors["w_in"][: sizes[0], :READINGS]
    cut["w_ff"] = tensors["w_ff"][: sizes[1], : sizes[0]]
    cut["w_rec"] = tensors["w_rec"][: sizes[1], : sizes[1]]
    return cut
