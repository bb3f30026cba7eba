"""Latency of one update of one vehicle, for every estimator, PyTorch's networks beside them.

Every call is timed on its own. The estimators take turns of 100 calls, many times over, so that whatever else
the machine does falls on all of them alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..appearance import look
from ..networks.encoder import ENCODER, scaled_inputs
from ..networks.forward import THRESHOLD, Weights, real_weights
from ..networks.network import roll_pitch_of_outputs
from ..networks.weights_file import load_network
from ..registry import create, names

RATE_HZ = 200.0
CALLS = 100
"""In a turn."""
PAPER_US = {"Loihi (the chip)": 10.0, "SNN, PyTorch": 555.0, "GRU, PyTorch": 150.0}
"""What the paper measured, on other hardware [µs]."""
PYTORCH = {"SNN, plain PyTorch": "att-snn-paper", "GRU, PyTorch": "att-rnn-paper"}
"""What is timed beside the estimators, and which of them it computes."""

Update = Callable[[NDArray[np.float64], NDArray[np.float64]], object]


class TorchSNN:
    """Att-SNN in floats, one PyTorch operation after the other, in float32."""

    def __init__(self) -> None:
        self.config, tensors = load_network(PYTORCH["SNN, plain PyTorch"])
        self.weights = Weights(*(torch.tensor(w).float() for w in real_weights(self.config, tensors)))
        self.encoder, sizes = np.zeros(1, ENCODER), [len(w) for w in self.weights]
        self.state = [torch.zeros(1, sizes[k]) for k in (0, 0, 0, 1, 1, 1, 3, 3)]

    @torch.no_grad()
    def update(self, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> NDArray[np.floating]:
        """Roll and pitch (1, 2) [rad] after one sample."""
        inputs = scaled_inputs(self.config.inputs, gyro[:, None], accel[:, None], self.encoder)
        x, w = torch.from_numpy(inputs[:, 0].astype(np.float32)), self.weights
        u0, v0, s0, u1, v1, s1, u2, v2 = self.state
        u2 = u2 * w.syn2 + s1 @ w.w_out.T
        v2 = v2 * w.mem2 + u2
        u1 = u1 * w.syn1 + s0 @ w.w_ff.T + s1 @ w.w_rec.T
        v1 = v1 * (1 - s1) * w.mem1 + u1
        u0 = u0 * w.syn0 + x @ w.w_in.T
        v0 = v0 * (1 - s0) * w.mem0 + u0
        s0, s1 = ((v > THRESHOLD).float() for v in (v0, v1))
        self.state = [u0, v0, s0, u1, v1, s1, u2, v2]
        return roll_pitch_of_outputs(v2.numpy() * self.config.output_scale)


class TorchGRU:
    """Att-RNN with PyTorch's own GRU."""

    def __init__(self) -> None:
        self.config, tensors = load_network(PYTORCH["GRU, PyTorch"])
        self.gru = torch.nn.GRU(6, self.config.hidden, 2, batch_first=True)
        own = {name.removeprefix("gru."): torch.tensor(x) for name, x in tensors.items() if "gru" in name}
        self.gru.load_state_dict(own)
        self.weight, self.bias = (torch.tensor(tensors[f"out.{name}"]) for name in ("weight", "bias"))
        self.state = torch.zeros(2, 1, self.config.hidden)

    @torch.no_grad()
    def update(self, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> NDArray[np.floating]:
        """Roll and pitch (1, 2) [rad] after one sample."""
        x = scaled_inputs(self.config.inputs, gyro[:, None], accel[:, None])
        y, self.state = self.gru(torch.from_numpy(x.astype(np.float32)), self.state)
        return roll_pitch_of_outputs((y[:, 0] @ self.weight.T + self.bias).numpy())


def contenders() -> dict[str, Update]:
    """`update` of every estimator but the truth, of two networks of layers, and of these in PyTorch."""
    torch.set_num_threads(1)
    found: dict[str, Update] = {
        name: create(name, RATE_HZ, vehicle="hummingbird").update
        for name in (*names(), *PYTORCH.values())
        if name != "truth"
    }
    return found | dict(zip(PYTORCH, (TorchSNN().update, TorchGRU().update), strict=True))


def measure(updates: Mapping[str, Update], rounds: int) -> dict[str, NDArray[np.float64]]:
    """Time of each call [µs], in turns."""
    rng = np.random.default_rng(0)
    gyro = rng.normal(0.0, 0.5, (CALLS, 1, 3))
    accel = rng.normal([0.0, 0.0, 9.81], 0.5, (CALLS, 1, 3))
    samples = list(zip(gyro, accel, strict=True))
    taken: dict[str, list[int]] = {name: [] for name in updates}
    for turn in range(rounds + 1):
        for name, update in updates.items():
            if turn > 1 and np.median(taken[name]) > 5e5 and turn % 10:
                continue  # the slowest need no more than a tenth of the turns
            for sample in samples:
                begin = time.perf_counter_ns()
                update(*sample)
                end = time.perf_counter_ns()
                if turn > 0:
                    taken[name].append(end - begin)
    return {name: np.array(each) / 1e3 for name, each in taken.items()}


def point(name: str) -> dict[str, Any]:
    """Keywords of matplotlib's `plot` for a contender's time: hollow for PyTorch's and for a part of one."""
    estimator = PYTORCH.get(name, name.split(",")[0])
    colour, _, marker = look(estimator)
    return {"color": colour, "marker": marker, "mfc": colour if estimator == name else "white"}
