"""Initial weights: random, solved from data, or read from a file; re-initialisation of dead neurons."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from estimators.networks.network import real_weights
from estimators.networks.symmetry import OPERATIONS
from estimators.networks.weights_file import load_network

from .config import TrainConfig
from .data import TrainingFlights, sample_windows
from .fused import Fused
from .models import MEMBRANE, AttRNN, AttSNN

DEAD = (1e-3, 0.999)
"""Spikes per step below and above which a hidden neuron carries no information."""

Range = tuple[float, float]
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


def initial_model(config: TrainConfig, flights: TrainingFlights, steps: int) -> AttSNN | AttRNN:
    """The network of a run before its first update; windows of `steps` samples solve a solved one.

    Raises:
        ValueError: Layers of a size that the network cannot have, or weights of another network.
    """
    torch.manual_seed(config.seed)
    encoding, hidden = config.encoding, config.hidden
    if config.model == "att-rnn":
        if encoding != hidden:
            raise ValueError(f"att-rnn: layers of {encoding} and {hidden} units, should be equal")
        model = AttRNN(hidden, config.outputs)
    else:
        if config.symmetric and not config.init and min(encoding, hidden) < len(OPERATIONS):
            raise ValueError(
                f"symmetric: layers of {encoding} and {hidden} neurons, at least {len(OPERATIONS)} of each "
                "share weights; give more, or symmetric=false"
            )
        kernels = Fused(config.quantised, config.recurrent_delay, config.threads)
        how = (config.output_scale, config.symmetric, config.outputs)
        chip = (config.finest_exponent, config.after_spike, config.parametrisation)
        model = AttSNN(encoding, hidden, kernels, *how, *chip)
    if config.init:
        initialise_from_weights(model, config.init)
        if isinstance(model, AttSNN):
            model.disconnect_zeros()
    elif isinstance(model, AttSNN) and config.initialisation == "random":
        initialise_random(model, config.seed)
    elif isinstance(model, AttSNN):
        samples = sample_windows(config, flights, steps, (config.seed, 0))
        initialise_from_data(model, *samples, config.seed, config.steps_per_sample)
    return model


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
    fan_in: int = 25,
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
    inputs = x.shape[-1]
    preferred = inputs if inputs > 6 else 5  # of readings alone, all but the vertical force
    every = np.arange(h0)
    deviation = x.reshape(-1, inputs).std(0)
    directions = rng.normal(size=(h0, inputs)) * (rng.random((h0, inputs)) < 0.3)
    directions[every, every % preferred] += np.where(every // preferred % 2 == 0, -2.0, 2.0)
    gain = np.exp(rng.uniform(math.log(0.05), math.log(0.5), (h0, 1)))
    tau = model.tau("syn0").detach().numpy()[:, None]
    w_in = directions / np.linalg.norm(directions, axis=1, keepdims=True) / deviation * gain * (1 - tau)
    w_ff = np.zeros((h1, h0))
    for row in w_ff:
        chosen = rng.choice(h0, min(fan_in, h0), replace=False)
        row[chosen] = rng.normal(size=chosen.size)
    w_rec = rng.normal(size=(h1, h1)) * (rng.random((h1, h1)) < 0.1) * 0.02
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
    """Continue from a weights file.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not weights of such a network.
    """
    config, tensors = load_network(path)
    layers = f"{config.model} with {config.encoding} + {config.hidden} neurons for {config.outputs}"
    layers += ", with after-spike currents" if config.after_spike else ""
    if isinstance(model, AttRNN):
        if (config.model, config.n_outputs, config.hidden) != ("att-rnn", *model.out.weight.shape):
            raise ValueError(f"init: {path} holds {layers}")
        model.load_state_dict({name: torch.tensor(value) for name, value in tensors.items()})
        return
    sizes = config.encoding, config.hidden, config.outputs, config.after_spike
    ours = (*model.w_ff.shape[::-1], model.outputs, "w_after" in model.matrices)
    if (config.model, *sizes) != ("att-snn", *ours):
        raise ValueError(f"init: {path} holds {layers}")
    values = real_weights(config, tensors)._asdict()
    for name in model.taus:
        model.set_taus(name, np.clip(values[name], 1 / 1024, 4095 / 4096))
    for name in model.matrices:
        model.set_weights(name, values[name])


def reinitialise_dead_neurons(model: AttSNN, x: NDArray[np.float64], seed: int) -> int:
    """Draw new input weights of hidden neurons that never or always spike; their output weights become 0.

    The estimate does not change: one of the neurons that always spike, or where weights are shared the first
    group of them, stays and takes over the output weights of the others. A re-initialised neuron reads ten
    encoders and ten other hidden neurons, and its after-spike weight is as at first.

    Returns how many neurons were re-initialised; `x` are scaled inputs, shape (n, T, 6).
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    first, second = layer_spikes(model, x)
    group = model.first("mem1")
    rate = (np.bincount(group, second.mean((0, 1))) / np.maximum(np.bincount(group), 1))[group]
    always = rate > DEAD[1]
    stays = always & (group == group[always.argmax()])
    dead = np.flatnonzero((rate < DEAD[0]) | (always & ~stays))
    active = np.setdiff1d(np.arange(rate.size), dead)
    if not dead.size or not active.size:
        return 0
    with torch.no_grad():
        w = {name: value.numpy().astype(np.float64) for name, value in model.weights()._asdict().items()}
        for name in ("w_rec", "w_out"):
            if always.any():
                w[name][:, stays] = w[name][:, always].sum(1, keepdims=True) / stays.sum()
            w[name][:, dead] = 0.0
        tau = model.shared("mem1", np.exp(-1.0 / np.exp(rng.uniform(0.0, math.log(100.0), rate.size))))
        for name in ("syn1", "mem1"):
            model.set_taus(name, tau[dead], dead)
    for row in dead:
        for name, sources in (("w_ff", np.arange(first.shape[2])), ("w_rec", active)):
            w[name][row] = 0.0
            chosen = rng.choice(sources, min(10, sources.size), replace=False)
            w[name][row, chosen] = rng.normal(size=chosen.size)
    for name in ("w_ff", "w_rec"):
        w[name] = model.shared(name, w[name])
    drive = np.concatenate([first, second], 2) @ np.hstack([w["w_ff"], w["w_rec"]])[dead].T
    current = filtered(drive, tau[dead])
    scale = np.ones(rate.size)
    scale[dead] = drive_scale(current, (0.1, 0.5), rng)
    for name in ("w_ff", "w_rec"):
        model.set_weights(name, w[name] * model.shared("mem1", scale)[:, None])
    model.set_weights("w_out", w["w_out"])
    if "w_after" in model.matrices:
        w["w_after"][dead] = AFTER_SPIKE
        model.set_weights("w_after", w["w_after"])
    model.constrain()
    return int(dead.size)


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
