"""Initial weights: random, solved from data, or read from a file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from estimators.networks.network import real_weights
from estimators.networks.weights_file import load_network

from .models import MEMBRANE, AttRNN, AttSNN

Range = tuple[float, float]
TAU_LIMITS: Range = (1 / 1024, 4095 / 4096)
"""Range of time constants that are taken over from other weights."""
PAPER_DECAYS = {"syn0": 0.08, "mem0": 0.03, "syn1": 0.08, "mem1": 0.03, "syn2": 0.5, "mem2": 0.08}
PAPER_DECAYS |= {"syn_after": 0.08}
"""1 - τ of every neuron at first in the paper's code, github.com/tudelft/neuromorphic_attitude_estimation."""
SOLVED_TAUS = {
    "syn0": (0.5, 4.0),
    "mem0": (60.0, 400.0),
    "syn1": (1.0, 400.0),
    "mem1": (20.0, 200.0),
    "syn2": (1.5, 1.5),
    "mem2": (200.0, 200.0),
    "syn_after": (1.0, 100.0),
}
"""The same of a solved network."""
AFTER_SPIKE = -0.02
"""Its after-spike weights: a little adaptation."""
FAN_IN = 25
"""Encoders that each hidden neuron of a solved network reads."""


def initialise_random(model: AttSNN, seed: int) -> None:
    """The initial values of the paper's published code: one time constant a layer, weights at random.

    Into the encoding and the output layer uniform within ± 1 / √inputs, the others normal with a variance of
    2 / hidden, over 1 - τ_mem of the neurons that they lead to.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    values = {name: 1.0 - np.full(getattr(model, name).shape, PAPER_DECAYS[name]) for name in model.taus}
    for name in model.matrices:
        shape = getattr(model, name).shape
        limit, deviation = 1 / math.sqrt(shape[1]), math.sqrt(2 / shape[0])
        edge = name in ("w_in", "w_out")
        drawn = rng.uniform(-limit, limit, shape) if edge else rng.normal(0.0, deviation, shape)
        values[name] = drawn * (1.0 - values[MEMBRANE[name]]).reshape(-1, 1)
    for name in model.taus:
        model.set_taus(name, values[name])
    for name in model.matrices:
        model.set_weights(name, values[name])
    model.constrain()


def initialise_from_data(
    model: AttSNN,
    x: NDArray[np.float64],
    target: NDArray[np.floating],
    seed: int,
    steps_per_sample: int = 1,
    fan_in: int = FAN_IN,
) -> None:
    """Solve, not train, a network: a leaky integrator over random features of the input.

    Encoders have random directions in the inputs and log-uniform gains over a decade; hidden neurons read a
    few encoders each over time constants from a step to seconds. Each layer is scaled so that its currents
    reach the threshold on the data, and the output weights are solved by ridge regression (the Neural
    Engineering Framework, Eliasmith & Anderson 2003).

    Args:
        model: To fill.
        x: Scaled inputs, shape (n, T, inputs).
        target: Of the outputs, shape (n, T, outputs).
        seed: Of the random directions.
        steps_per_sample: Network steps for each sample: the slow time constants are that much longer.
        fan_in: Encoders that each hidden neuron reads.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    initialise_taus(model, SOLVED_TAUS, rng, steps_per_sample)
    h0, h1 = model.w_in.shape[0], model.w_ff.shape[0]
    w_in = random_encoders(x, model.tau("syn0").detach().numpy(), 5, rng)  # none for the vertical force alone
    w_ff = np.zeros((h1, h0))
    for row in w_ff:
        read_some(row, np.arange(h0), rng, fan_in)
    w_rec = sparse_recurrence(h1, rng)
    model.set_weights("w_in", w_in)
    model.constrain()
    w_ff = model.shared("w_ff", w_ff)
    current = filtered(layer_spikes(model, x)[0] @ w_ff.T, model.tau("syn1").detach().numpy())
    model.set_weights("w_ff", w_ff * model.shared("mem1", drive_scale(current, (0.2, 1.0), rng)[:, None]))
    model.set_weights("w_rec", w_rec)
    if "w_after" in model.matrices:
        model.set_weights("w_after", np.full((h1, 1), AFTER_SPIKE))
    model.constrain()
    w_out = solve_outputs(model, x, target)
    model.set_weights("w_out", model.sharing["w_out"].mean(w_out) if model.sharing else w_out)
    model.constrain()


def initialise_from_weights(model: AttSNN | AttRNN, path: str | Path) -> None:
    """Continue from a weights file, of a network with these layers.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not such a file.
    """
    config, tensors = load_network(path)
    if isinstance(model, AttRNN):
        model.load_state_dict({name: torch.tensor(value) for name, value in tensors.items()})
        return
    values = real_weights(config, tensors)._asdict()
    model.output_scale = config.output_scale
    for name in model.taus:
        model.set_taus(name, np.clip(values[name], *TAU_LIMITS))
    for name in model.matrices:
        model.set_weights(name, values[name])
    model.disconnect_zeros()


def random_encoders(
    x: NDArray[np.float64], tau: NDArray, preferred: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Input weights of encoding neurons: random directions, of which each prefers one of the first inputs.

    Args:
        x: Scaled inputs (n, T, inputs), whose standard deviations the weights make up for.
        tau: Time constants of the currents, (neurons,).
        preferred: Inputs that are preferred in turn.
        rng: Source of all draws.
    """
    every, shape = np.arange(tau.size), (tau.size, x.shape[-1])
    directions = rng.normal(size=shape) * (rng.random(shape) < 0.3)
    directions[every, every % preferred] += np.where(every // preferred % 2 == 0, -2.0, 2.0)
    gain = np.exp(rng.uniform(math.log(0.05), math.log(0.5), (tau.size, 1)))
    deviation = np.maximum(x.reshape(-1, shape[1]).std(0), 1e-3)
    return (
        directions / np.linalg.norm(directions, axis=1, keepdims=True) / deviation * gain * (1 - tau[:, None])
    )


def read_some(
    row: NDArray[np.float64], sources: NDArray[np.int64], rng: np.random.Generator, fan_in: int = FAN_IN
) -> None:
    """Draw a hidden neuron's weights from a few of the sources; the others in `row` stay."""
    chosen = rng.choice(sources, min(fan_in, sources.size), replace=False)
    row[chosen] = rng.normal(size=chosen.size)


def sparse_recurrence(neurons: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Weak weights of a tenth of the connections among hidden neurons."""
    shape = (neurons, neurons)
    return rng.normal(size=shape) * (rng.random(shape) < 0.1) * 0.02


def initialise_taus(
    model: AttSNN, ranges: Mapping[str, Range], rng: np.random.Generator, stretch: int = 1
) -> None:
    """Draw time constants log-uniform between the limits of their kind [steps], slow ones times `stretch`."""
    for name in model.taus:
        factor = 1 if name in ("syn0", "syn2") else stretch
        low, high = (math.log(limit * factor) for limit in ranges[name])
        shape = getattr(model, name).shape
        model.set_taus(name, np.exp(-1.0 / np.exp(rng.uniform(low, high, shape))))


def layer_spikes(model: AttSNN, x: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Spikes of both layers on inputs (n, T, inputs), (n, T, h)."""
    with torch.no_grad():
        model(torch.from_numpy(x))
    return model.kernels.spikes()


def filtered(signal: NDArray, tau: NDArray) -> NDArray:
    """First-order filter u[t] = τ u[t-1] + signal[t] along time, (n, T, k)."""
    out = np.empty(signal.shape, np.float32)
    state = np.zeros((signal.shape[0], signal.shape[2]))
    for t in range(signal.shape[1]):
        state = tau * state + signal[:, t]
        out[:, t] = state
    return out


def drive_scale(current: NDArray, parts: Range, rng: np.random.Generator) -> NDArray:
    """Factors (k,) of neurons' input weights that make the means of their currents (n, T, k) positive.

    The standard deviations become a part of the threshold that is log-uniform between the two `parts`.
    """
    low, high = map(math.log, parts)
    part = np.exp(rng.uniform(low, high, current.shape[2]))
    sign = np.where(current.mean((0, 1)) < 0, -1.0, 1.0)
    return sign * 0.5 * part / np.maximum(current.std((0, 1)), 1e-6)


def solve_outputs(
    model: AttSNN, x: NDArray[np.float64], target: NDArray[np.floating], first: int = 0
) -> NDArray:
    """Ridge regression from the hidden spikes, filtered as the outputs filter them, to the targets.

    Args:
        model: Whose output weights to solve.
        x: Scaled inputs (n, T, inputs).
        target: Of the outputs, (n, T, outputs).
        first: First hidden neuron that the outputs may read.

    Returns:
        Weights (outputs, hidden neurons from the first on).
    """
    _, spikes = layer_spikes(model, x)
    features = spikes[..., first:].astype(np.float32)
    for name in ("syn2", "mem2"):
        features = filtered(features, model.tau(name).detach().numpy())
    settled = x.shape[1] // 4
    a = features[:, settled:].reshape(-1, features.shape[2]).astype(np.float64)
    b = target[:, settled:].reshape(-1, target.shape[-1]) / model.output_scale
    gram = a.T @ a
    ridge = max(1e-3 * np.trace(gram) / len(gram), 1e-9)  # neurons may all be silent
    return np.linalg.solve(gram + ridge * np.eye(len(gram)), a.T @ b).T
