"""How the weights of a network start: random, solved from data, or read from a file; and neurons revived."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from estimators.networks.forward import MATRICES, TIME_CONSTANTS
from estimators.networks.network import real_weights
from estimators.networks.weights_file import load_network

from .models import AttRNN, AttSNN

IDLE = (1e-3, 0.999)
"""Spikes per step below and above which a hidden neuron says nothing."""


@dataclass(frozen=True)
class Ranges:
    """Time constants at the start, log-uniform between two values each [network steps]."""

    encode_syn: tuple[float, float]
    encode_mem: tuple[float, float]
    hidden_syn: tuple[float, float]
    hidden_mem: tuple[float, float]
    output_syn: float
    output_mem: float


PAPER_RANGES = Ranges((1.0, 5.0), (1.0, 5.0), (1.0, 5.0), (1.0, 5.0), 2.0, 5.0)
WIDE_RANGES = Ranges((0.5, 4.0), (60.0, 400.0), (1.0, 400.0), (20.0, 200.0), 1.5, 200.0)


def start_like_the_paper(model: AttSNN, seed: int) -> None:
    """Weights of unit scale over the square root of their number, short time constants."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    _start_taus(model, PAPER_RANGES, rng)
    for name in MATRICES:
        w = getattr(model, name)
        with torch.no_grad():
            w.copy_(torch.tensor(rng.normal(0, 1 / math.sqrt(w.shape[1]), w.shape)))
    model.constrain()


def start_from_data(
    model: AttSNN,
    x: NDArray[np.float64],
    roll_pitch: NDArray[np.floating],
    seed: int,
    steps_per_sample: int = 1,
    fan_in: int = 25,
) -> None:
    """A network that is solved, not trained: a leaky integrator over random features of the real input.

    Encoders point in random directions of the inputs, with gains spread over a decade; hidden neurons read a
    few encoders each over time constants from a step to seconds. Each layer is scaled so that its currents
    reach the threshold on the data, and the output weights are solved by ridge regression (the Neural
    Engineering Framework, Eliasmith & Anderson 2003).

    Args:
        model: To fill.
        x: Scaled inputs, shape (n, T, 6).
        roll_pitch: Targets, shape (n, T, 2) [rad].
        seed: Of the random directions.
        steps_per_sample: Network steps for each sample: the slow time constants are that much longer.
        fan_in: Encoders that each hidden neuron reads.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    _start_taus(model, WIDE_RANGES, rng, steps_per_sample)
    h0, h1 = model.w_in.shape[0], model.w_ff.shape[0]
    spread = x.reshape(-1, 6).std(0)
    directions = rng.normal(size=(h0, 6)) * (rng.random((h0, 6)) < 0.3)
    directions[np.arange(h0), np.arange(h0) % 5] += np.where(np.arange(h0) // 5 % 2 == 0, -2.0, 2.0)
    gain = np.exp(rng.uniform(math.log(0.05), math.log(0.5), (h0, 1)))
    tau = torch.sigmoid(model.syn0).detach().numpy()[:, None]
    w_in = directions / np.linalg.norm(directions, axis=1, keepdims=True) / spread * gain * (1 - tau)
    w_ff = np.zeros((h1, h0))
    for row in w_ff:
        chosen = rng.choice(h0, min(fan_in, h0), replace=False)
        row[chosen] = rng.normal(size=chosen.size)
    w_rec = rng.normal(size=(h1, h1)) * (rng.random((h1, h1)) < 0.1) * 0.02
    model.set_weights("w_in", w_in)
    model.constrain()
    w_ff = model.shared("w_ff", w_ff)
    model.set_weights("w_ff", w_ff * model.shared("mem1", _current_scale(model, x, w_ff, rng)))
    model.set_weights("w_rec", w_rec)
    model.constrain()
    w_out = _solve_outputs(model, x, roll_pitch)
    model.set_weights("w_out", model.ties["w_out"].mean(w_out) if model.ties else w_out)
    model.constrain()


def start_from_weights(model: AttSNN | AttRNN, path: str | Path) -> None:
    """Go on from a weights file.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not weights of such a network.
    """
    config, tensors = load_network(path)
    if isinstance(model, AttRNN):
        found = config.model, config.hidden
        if found != ("att-rnn", model.out.in_features):
            raise ValueError(f"init: {path} holds {found[0]} with {found[1]} hidden units")
        model.load_state_dict({name: torch.tensor(value) for name, value in tensors.items()})
        return
    found = config.model, config.encoding, config.hidden
    if found != ("att-snn", *model.w_ff.shape[::-1]):
        raise ValueError(f"init: {path} holds {found[0]} with {found[1]} + {found[2]} neurons")
    values = real_weights(config, tensors)._asdict()
    for name in MATRICES:
        model.set_weights(name, values[name])
    for name in TIME_CONSTANTS:
        inside = np.clip(values[name], 1 / 1024, 4095 / 4096)
        with torch.no_grad():
            getattr(model, name).copy_(torch.tensor(np.log(inside / (1 - inside))))


def revive(model: AttSNN, x: NDArray[np.float64], seed: int, fan_in: int = 20) -> int:
    """Give hidden neurons that never or always spike something new to say, and nobody that listens yet.

    The estimate stays as it is: what neurons that always spike contribute goes to those of them that stay,
    the first or, where weights are shared, the first group. A revived neuron reads a few encoders and a few
    live hidden neurons, at a rate that its drive spreads over.

    Args:
        model: To change.
        x: Scaled inputs, shape (n, T, 6).
        seed: Of the new weights.
        fan_in: Neurons that each revived one reads, half of either layer.

    Returns:
        How many neurons were revived.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    first, second = _spikes(model, x)
    group = model.ties["mem1"].first if model.ties else np.arange(second.shape[2])
    rate = (np.bincount(group, second.mean((0, 1))) / np.maximum(np.bincount(group), 1))[group]
    always = rate > IDLE[1]
    stays = always & (group == group[always.argmax()])
    idle = np.flatnonzero((rate < IDLE[0]) | (always & ~stays))
    alive = np.setdiff1d(np.arange(rate.size), idle)
    if not idle.size or not alive.size:
        return 0
    with torch.no_grad():
        w = {name: value.numpy().astype(np.float64) for name, value in model.weights()._asdict().items()}
        for name in ("w_rec", "w_out"):
            if always.any():
                w[name][:, stays] = w[name][:, always].sum(1, keepdims=True) / stays.sum()
            w[name][:, idle] = 0.0
        tau = model.shared("mem1", np.exp(-1.0 / np.exp(rng.uniform(0.0, math.log(100.0), rate.size))))
        for name in ("syn1", "mem1"):
            getattr(model, name)[idle] = torch.from_numpy(np.log(tau / (1 - tau)))[idle].float()
    for row in idle:
        for name, sources in (("w_ff", np.arange(first.shape[2])), ("w_rec", alive)):
            w[name][row] = 0.0
            chosen = rng.choice(sources, min(fan_in // 2, sources.size), replace=False)
            w[name][row, chosen] = rng.normal(size=chosen.size)
    for name in ("w_ff", "w_rec"):
        w[name] = model.shared(name, w[name])
    drive = np.concatenate([first, second], 2) @ np.hstack([w["w_ff"], w["w_rec"]])[idle].T
    current = _filtered(drive, tau[idle])
    scale = np.ones(rate.size)
    wanted = np.exp(rng.uniform(math.log(0.1), math.log(0.5), idle.size))
    towards = np.where(current.mean((0, 1)) < 0, -1.0, 1.0)
    scale[idle] = 0.5 * wanted / np.maximum(current.std((0, 1)), 1e-6) * towards
    for name in ("w_ff", "w_rec"):
        model.set_weights(name, w[name] * model.shared("mem1", scale)[:, None])
    model.set_weights("w_out", w["w_out"])
    model.constrain()
    return int(idle.size)


def _start_taus(model: AttSNN, ranges: Ranges, rng: np.random.Generator, stretch: int = 1) -> None:
    with torch.no_grad():
        for name, limits in (
            ("syn0", ranges.encode_syn),
            ("mem0", ranges.encode_mem),
            ("syn1", ranges.hidden_syn),
            ("mem1", ranges.hidden_mem),
            ("syn2", (ranges.output_syn,) * 2),
            ("mem2", (ranges.output_mem,) * 2),
        ):
            parameter = getattr(model, name)
            low, high = (math.log(limit * (1 if name in ("syn0", "syn2") else stretch)) for limit in limits)
            steps = np.exp(rng.uniform(low, high, parameter.shape))
            tau = np.exp(-1.0 / steps)
            parameter.copy_(torch.tensor(np.log(tau / (1 - tau))))


def _spikes(model: AttSNN, x: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Spikes of both layers, (n, T, h)."""
    with torch.no_grad():
        model(torch.from_numpy(x))
    return model.backend.spikes()


def _filtered(signal: NDArray, tau: NDArray) -> NDArray:
    """First-order filter u[t] = τ u[t-1] + signal[t] along time, (n, T, k)."""
    out = np.empty(signal.shape, np.float32)
    state = np.zeros((signal.shape[0], signal.shape[2]))
    for t in range(signal.shape[1]):
        state = tau * state + signal[:, t]
        out[:, t] = state
    return out


def _current_scale(model: AttSNN, x: NDArray[np.float64], w_ff: NDArray, rng: np.random.Generator) -> NDArray:
    """Factor for each hidden neuron that makes its mean drive fill its membrane to a random part of 0.5."""
    spikes, _ = _spikes(model, x)
    tau = torch.sigmoid(model.syn1).detach().numpy()
    current = _filtered(spikes @ w_ff.T, tau)
    rate = np.exp(rng.uniform(math.log(0.2), math.log(1.0), len(w_ff)))
    sign = np.where(current.mean((0, 1)) < 0, -1.0, 1.0)  # towards spiking, not silence
    return (sign * 0.5 * rate / np.maximum(current.std((0, 1)), 1e-6))[:, None]


def _solve_outputs(model: AttSNN, x: NDArray[np.float64], roll_pitch: NDArray[np.floating]) -> NDArray:
    """Ridge regression from the hidden spikes, filtered as the outputs filter them, to roll and pitch."""
    _, spikes = _spikes(model, x)
    features = spikes.astype(np.float32)
    for name in ("syn2", "mem2"):
        features = _filtered(features, torch.sigmoid(getattr(model, name)).detach().numpy())
    settled = x.shape[1] // 4
    a = features[:, settled:].reshape(-1, features.shape[2]).astype(np.float64)
    b = roll_pitch[:, settled:].reshape(-1, 2) / model.output_scale
    gram = a.T @ a
    ridge = max(1e-3 * np.trace(gram) / len(gram), 1e-9)  # neurons may all be silent
    return np.linalg.solve(gram + ridge * np.eye(len(gram)), a.T @ b).T
