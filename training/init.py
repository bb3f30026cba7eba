"""Initial weights: random, or solved from data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from estimators.networks.forward import real_weights
from estimators.networks.weights_file import AXES, READINGS, SET_POINTS

from .config import TrainConfig, estimator_weights
from .models import MEMBRANES, AttSNN

Range = tuple[float, float]
TAU_LIMITS: Range = (1 / 1024, 4095 / 4096)
"""Range of time constants that are taken over from other weights."""
PAPER_DECAYS = {"syn0": 0.08, "mem0": 0.03, "syn1": 0.08, "mem1": 0.03, "syn2": 0.5, "mem2": 0.08}
PAPER_DECAYS |= {"syn_after": 0.08}
"""1 - τ of every neuron at first in the paper's code, github.com/tudelft/neuromorphic_attitude_estimation."""
AFTER_SPIKE = -0.02
"""After-spike weights of a solved network: a little adaptation."""
CODER_TAU = 0.6
"""Of the membranes of hidden neurons whose currents are at first the estimate, turned and scaled."""


class SolvedStart(NamedTuple):
    """What differs between solved networks."""

    taus: dict[str, Range]
    """Ranges of the time constants, log-uniform [steps]."""
    preferred: int = 0
    """Inputs that encoders prefer in turn, the first ones; 0: all."""
    stretch: int = 1
    """What slow time constants are multiplied by: network steps for each sample."""
    fan_in: int = 25
    """Encoders, and spikes of an estimator, that each hidden neuron reads."""


ESTIMATOR_START = SolvedStart(
    {
        "syn0": (0.5, 4.0),
        "mem0": (60.0, 400.0),
        "syn1": (1.0, 400.0),
        "mem1": (20.0, 200.0),
        "syn2": (1.5, 1.5),
        "mem2": (200.0, 200.0),
        "syn_after": (1.0, 100.0),
    },
    preferred=5,
)
"""No encoder prefers the vertical force alone."""
CONTROLLER_START = SolvedStart(
    {
        "syn0": (0.5, 2.0),
        "mem0": (1.0, 60.0),
        "syn1": (0.5, 100.0),
        "mem1": (1.0, 100.0),
        "syn2": (0.5, 0.5),
        "mem2": (1.5, 1.5),
        "syn_after": (1.0, 100.0),
    }
)
"""The slowest hold an integral."""


class GivenEstimator(NamedTuple):
    """The part of a network that does not change."""

    sizes: tuple[int, int] = (0, 0)
    """Its encoding and hidden neurons; 0 without one."""
    values: dict[str, NDArray[np.float64]] = {}  # noqa: RUF012  (never changed)
    """Its weights and time constants by name, in units of 1.0, but for the readout's."""
    readout: NDArray[np.float64] = np.zeros((2, 0))
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
        values[name] = drawn * (1.0 - values[MEMBRANES[AXES[name][0]]]).reshape(-1, 1)
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
    start: SolvedStart,
    estimator: GivenEstimator | None = None,
) -> None:
    """Solve, not train, a network: a leaky integrator over random features of the input.

    Encoders have random directions in the inputs and log-uniform gains over a decade; hidden neurons read a
    few encoders each over time constants from a step to seconds. Each layer is scaled so that its currents
    reach the threshold on the data, and the output weights are solved by ridge regression (the Neural
    Engineering Framework, Eliasmith & Anderson 2003). On an estimator hidden neurons read a few of its spikes
    as well, and the currents of half of them are its estimate, filtered as its own outputs filter it.

    Args:
        model: To fill.
        x: Scaled inputs, shape (n, T, inputs).
        target: Of the outputs, shape (n, T, outputs).
        seed: Of what is random.
        start: Time constants and more.
        estimator: A part of the network that is given, and stays.
    """
    rng, given = np.random.default_rng(np.random.SeedSequence(seed)), estimator or GivenEstimator()
    (e0, e1), (h1, h0) = given.sizes, model.w_ff.shape
    if e0:
        _connect(model, given.sizes)
    _draw_taus(model, start, rng)
    values = {name: np.zeros(getattr(model, name).shape) for name in model.matrices}
    for name, value in given.values.items():
        if name in values:
            values[name][tuple(slice(0, size) for size in value.shape)] = value
        else:
            model.set_taus(name, np.clip(value, *TAU_LIMITS), slice(0, len(value)))
    inputs = np.flatnonzero(model.get_buffer("w_in_connected")[-1].numpy()) if e0 else np.arange(x.shape[2])
    tau = model.tau("syn0").detach().numpy()[e0:]
    preferred = start.preferred or inputs.size
    values["w_in"][e0:, inputs] = _random_encoders(np.ascontiguousarray(x[..., inputs]), tau, preferred, rng)
    if "w_after" in values:
        values["w_after"][e1:] = AFTER_SPIKE
    own = h0 - e0
    w = np.zeros((h1 - e1, own + e1))
    for row in w:
        for sources in (np.arange(own), np.arange(own, own + e1)):
            count = min(start.fan_in, sources.size)
            chosen = rng.choice(sources, count, replace=False) if count else sources
            row[chosen] = rng.normal(size=chosen.size)
    coders = (h1 - e1) // 2 if e1 else 0
    w[:coders, :own] = 0.0
    w[:coders, own:] = rng.normal(size=(coders, 2)) @ given.readout
    for name, memory in (("syn1", given.memory), ("mem1", CODER_TAU)):
        if coders:
            model.set_taus(name, np.full(coders, memory), slice(e1, e1 + coders))
    shape = (h1 - e1, h1 - e1)
    values["w_rec"][e1:, e1:] = rng.normal(size=shape) * (rng.random(shape) < 0.1) * 0.02
    _set_weights(model, values)
    first, second = _layer_spikes(model, x)
    features = np.concatenate([first[..., e0:], second[..., :e1]], 2)
    w = model.shared("w_ff", w)
    current = _filtered(features @ w.T, model.tau("syn1").detach().numpy()[e1:])
    w = w * model.shared("mem1", _drive_scale(current, rng)[:, None])
    values["w_ff"][e1:, e0:], values["w_rec"][e1:, :e1] = w[:, :own], w[:, own:]
    _set_weights(model, values)
    w_out = _solve_outputs(model, x, target, e1)
    values["w_out"][:, e1:] = model.sharing["w_out"].mean(w_out) if model.sharing else w_out
    _set_weights(model, values)
    model.freeze(e0, e1)


def _set_weights(model: AttSNN, values: Mapping[str, NDArray]) -> None:
    for name, value in values.items():
        model.set_weights(name, value)
    model.constrain()


def _connect(model: AttSNN, sizes: tuple[int, int]) -> None:
    """Leave the connections alone that a controller on an estimator of these sizes has."""
    e0, e1 = sizes
    allowed = {name: getattr(model, f"{name}_connected") for name in ("w_in", "w_ff", "w_rec", "w_out")}
    allowed["w_in"][:e0, READINGS:] = False
    allowed["w_in"][e0:, SET_POINTS:READINGS] = False  # the estimator alone reads the accelerometer
    allowed["w_ff"][:e1, e0:] = allowed["w_ff"][e1:, :e0] = False
    allowed["w_rec"][:e1, e1:] = False
    allowed["w_out"][:, :e1] = False


def _random_encoders(
    x: NDArray[np.float64], tau: NDArray, preferred: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Random directions in the inputs (n, T, inputs), of which each prefers one of the first ones."""
    every, shape = np.arange(tau.size), (tau.size, x.shape[-1])
    directions = rng.normal(size=shape) * (rng.random(shape) < 0.3)
    directions[every, every % preferred] += np.where(every // preferred % 2 == 0, -2.0, 2.0)
    gain = np.exp(rng.uniform(math.log(0.05), math.log(0.5), (tau.size, 1)))
    deviation = np.maximum(x.reshape(-1, shape[1]).std(0), 1e-3)
    return (
        directions / np.linalg.norm(directions, axis=1, keepdims=True) / deviation * gain * (1 - tau[:, None])
    )


def _draw_taus(model: AttSNN, start: SolvedStart, rng: np.random.Generator) -> None:
    for name in model.taus:
        factor = 1 if name in ("syn0", "syn2") else start.stretch
        low, high = (math.log(limit * factor) for limit in start.taus[name])
        shape = getattr(model, name).shape
        model.set_taus(name, np.exp(-1.0 / np.exp(rng.uniform(low, high, shape))))


def _layer_spikes(model: AttSNN, x: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Spikes of both layers on inputs (n, T, inputs), (n, T, h)."""
    with torch.no_grad():
        model(torch.from_numpy(x))
    return model.kernels.spikes()


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


def _solve_outputs(
    model: AttSNN, x: NDArray[np.float64], target: NDArray[np.floating], first: int = 0
) -> NDArray:
    """Output weights by ridge regression from the hidden spikes, filtered as the outputs filter them."""
    _, spikes = _layer_spikes(model, x)
    features = spikes[..., first:].astype(np.float32)
    for name in ("syn2", "mem2"):
        features = _filtered(features, model.tau(name).detach().numpy())
    settled = x.shape[1] // 4
    a = features[:, settled:].reshape(-1, features.shape[2]).astype(np.float64)
    b = target[:, settled:].reshape(-1, target.shape[-1]) / model.output_scale
    gram = a.T @ a
    ridge = max(1e-3 * np.trace(gram) / len(gram), 1e-9)  # neurons may all be silent
    return np.linalg.solve(gram + ridge * np.eye(len(gram)), a.T @ b).T
