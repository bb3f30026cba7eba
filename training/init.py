"""Initial weights: random as in the paper, or, for a controller, solved from flights."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from estimators.networks.layer_parameters import MATRICES, PARAMETERS

from .models import MEMBRANES, AttSNN

CONTROLLER_TAUS = {
    "syn0": (0.5, 2.0),
    "mem0": (1.0, 60.0),
    "syn1": (0.5, 100.0),
    "mem1": (1.0, 100.0),
    "syn2": (0.5, 0.5),
    "mem2": (1.5, 1.5),
}
"""Ranges of a controller's initial time constants, log-uniform [steps]; the slowest approximate an
integral."""
FAN_IN = 25
"""Initial number of encoders that each hidden neuron of a controller reads."""


def initialise_random(model: AttSNN, seed: int) -> None:
    """Draw the initial weights of the paper's published code; the constants of the model are not changed.

    Weights into the encoding and the output layer are uniform within ± 1 / √inputs. The others are normal
    with a variance of 2 / hidden. All are divided by 1 - τ_mem of the target neurons.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    values = {}
    for name in MATRICES:
        shape = getattr(model, name).shape
        limit, deviation = 1 / math.sqrt(shape[1]), math.sqrt(2 / shape[0])
        edge = name in ("w_in", "w_out")
        drawn = rng.uniform(-limit, limit, shape) if edge else rng.normal(0.0, deviation, shape)
        values[name] = drawn * (1.0 - PARAMETERS[MEMBRANES[PARAMETERS[name].layer]].first)
    _set_weights(model, values)


@torch.no_grad()
def initialise_controller(
    model: AttSNN, x: NDArray[np.float64], target: NDArray[np.floating], seed: int
) -> None:
    """Initialise a controller by regression on random features of the input.

    Encoders have random directions in the inputs and log-uniform gains over a decade. Each hidden neuron
    reads a few encoders, with time constants from a step to half a second. Each layer is scaled so that its
    currents reach the threshold on the data. The output weights are solved by ridge regression (Neural
    Engineering Framework, Eliasmith & Anderson 2003).

    Args:
        model: Model to initialise.
        x: Scaled inputs, shape (n, T, inputs).
        target: Targets of the outputs, shape (n, T, outputs).
        seed: Seed of all random numbers.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    for name, limits in CONTROLLER_TAUS.items():
        low, high = map(math.log, limits)
        model.set_constants(name, np.exp(-1.0 / np.exp(rng.uniform(low, high, getattr(model, name).shape))))
    values = {name: np.zeros(getattr(model, name).shape) for name in MATRICES}
    values["w_in"] = _random_encoders(x, model.constants("syn0").detach().numpy(), rng)
    for k in range(len(values["w_ff"])):
        encoders = values["w_ff"][k].size
        chosen = rng.choice(encoders, min(FAN_IN, encoders), replace=False)
        values["w_ff"][k, chosen] = rng.normal(size=chosen.size)
    shape = values["w_rec"].shape
    values["w_rec"] = rng.normal(size=shape) * (rng.random(shape) < 0.1) * 0.02
    _set_weights(model, values)
    model(torch.from_numpy(x))
    first, _ = model.kernels.spikes()
    current = _filtered(first @ values["w_ff"].T, model.constants("syn1").detach().numpy())
    values["w_ff"] *= _drive_scale(current, rng)[:, None]
    _set_weights(model, values)
    values["w_out"] = _solve_outputs(model, x, target)
    _set_weights(model, values)


def _set_weights(model: AttSNN, values: Mapping[str, NDArray]) -> None:
    for name, value in values.items():
        model.set_weights(name, value)
    model.constrain()


def _random_encoders(x: NDArray[np.float64], tau: NDArray, rng: np.random.Generator) -> NDArray[np.float64]:
    """Random directions in the inputs (n, T, inputs), each of which prefers one of them."""
    every, shape = np.arange(tau.size), (tau.size, x.shape[-1])
    directions = rng.normal(size=shape) * (rng.random(shape) < 0.3)
    directions[every, every % shape[1]] += np.where(every // shape[1] % 2 == 0, -2.0, 2.0)
    gain = np.exp(rng.uniform(math.log(0.05), math.log(0.5), (tau.size, 1)))
    deviation = np.maximum(x.reshape(-1, shape[1]).std(0), 1e-3)
    return (
        directions / np.linalg.norm(directions, axis=1, keepdims=True) / deviation * gain * (1 - tau[:, None])
    )


def _filtered(signal: NDArray, tau: NDArray) -> NDArray:
    """First-order filter u[t] = τ u[t-1] + signal[t] along time, (n, T, k)."""
    out = np.empty(signal.shape, np.float32)
    state = np.zeros((signal.shape[0], signal.shape[2]))
    for t in range(signal.shape[1]):
        state = tau * state + signal[:, t]
        out[:, t] = state
    return out


def _drive_scale(current: NDArray, rng: np.random.Generator) -> NDArray:
    """Factors that make currents (n, T, k) positive, with a deviation of a fifth to all of the threshold."""
    part = np.exp(rng.uniform(math.log(0.2), math.log(1.0), current.shape[2]))
    sign = np.where(current.mean((0, 1)) < 0, -1.0, 1.0)
    return sign * 0.5 * part / np.maximum(current.std((0, 1)), 1e-6)


def _solve_outputs(model: AttSNN, x: NDArray[np.float64], target: NDArray[np.floating]) -> NDArray:
    """Output weights by ridge regression from the hidden spikes, filtered as the outputs filter them."""
    model(torch.from_numpy(x))
    _, spikes = model.kernels.spikes()
    features = spikes.astype(np.float32)
    for name in ("syn2", "mem2"):
        features = _filtered(features, model.constants(name).detach().numpy())
    settled = x.shape[1] // 4
    a = features[:, settled:].reshape(-1, features.shape[2]).astype(np.float64)
    b = target[:, settled:].reshape(-1, target.shape[-1]) / model.output_scale
    gram = a.T @ a
    ridge = max(1e-3 * np.trace(gram) / len(gram), 1e-9)  # neurons may all be silent
    return np.linalg.solve(gram + ridge * np.eye(len(gram)), a.T @ b).T
