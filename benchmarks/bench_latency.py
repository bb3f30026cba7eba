"""Latency of one update of one vehicle, for every estimator, PyTorch's networks beside them.

    python benchmarks/bench_latency.py [--out FOLDER]

Every call is timed on its own. The estimators take turns of 100 calls, many times over, so that whatever else
the machine does falls on all of them alike. Writes latency.csv and latency.png (after the paper's Fig. 9).
"""

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimators import create, names
from estimators.networks import real_weights, scaled_inputs
from estimators.protocol import NETWORKS
from estimators.weights_file import shipped_network
from quadsim.figures import STYLE

RATE_HZ = 200.0
CALLS = 100
PAPER_US = {"Loihi (the chip)": 10.0, "SNN, PyTorch": 555.0, "GRU, PyTorch": 150.0}
"""What the paper measured, on other hardware."""

Update = Callable[[NDArray[np.float64], NDArray[np.float64]], object]


class TorchSNN:
    """Att-SNN as one would write it in PyTorch: a loop of tensor operations, float32."""

    def __init__(self) -> None:
        self.config, tensors = shipped_network("att-snn")
        weights, taus = real_weights(self.config, tensors)
        self.w_in, self.w_ff, self.w_rec, self.w_out = (
            torch.tensor(w, dtype=torch.float32).T for w in weights
        )
        self.taus = [torch.tensor(tau, dtype=torch.float32) for tau in taus]
        sizes = [self.config.encoding, self.config.hidden, 2]
        self.u, self.v, self.s = ([torch.zeros(1, size) for size in sizes] for _ in range(3))

    @torch.no_grad()
    def update(self, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> NDArray[np.float32]:
        """Roll and pitch (1, 2) [rad] after one sample."""
        x = scaled_inputs(self.config.inputs, gyro[:, None], accel[:, None])[:, 0]
        drives = [
            torch.from_numpy(x.astype(np.float32)) @ self.w_in,
            self.s[0] @ self.w_ff + self.s[1] @ self.w_rec,
            self.s[1] @ self.w_out,
        ]
        for k, drive in enumerate(drives):
            self.u[k] = self.u[k] * self.taus[2 * k] + drive
            self.v[k] = self.v[k] * self.taus[2 * k + 1] + self.u[k]
            if k < 2:
                self.s[k] = (self.v[k] > 0.5).float()
                self.v[k] = self.v[k] * (1 - self.s[k])
        return self.v[2].numpy() * self.config.output_scale


class TorchGRU:
    """Att-RNN with PyTorch's own GRU."""

    def __init__(self) -> None:
        self.config, tensors = shipped_network("att-rnn")
        self.gru = torch.nn.GRU(6, self.config.hidden, 2, batch_first=True)
        own = {name.removeprefix("gru."): torch.tensor(x) for name, x in tensors.items() if "gru" in name}
        self.gru.load_state_dict(own)
        self.weight, self.bias = (torch.tensor(tensors[f"out.{name}"]) for name in ("weight", "bias"))
        self.state = torch.zeros(2, 1, self.config.hidden)

    @torch.no_grad()
    def update(self, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> NDArray[np.float32]:
        """Roll and pitch (1, 2) [rad] after one sample."""
        x = scaled_inputs(self.config.inputs, gyro[:, None], accel[:, None])
        y, self.state = self.gru(torch.from_numpy(x.astype(np.float32)), self.state)
        return (y[:, 0] @ self.weight.T + self.bias).numpy()


def contenders() -> dict[str, Update]:
    torch.set_num_threads(1)
    found: dict[str, Update] = {name: create(name, RATE_HZ).update for name in names() if name != "truth"}
    return found | {"SNN, plain PyTorch": TorchSNN().update, "GRU, PyTorch": TorchGRU().update}


def measure(updates: dict[str, Update], rounds: int) -> dict[str, NDArray[np.float64]]:
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


def draw(taken: dict[str, NDArray[np.float64]], path: Path) -> None:
    """Median and 99th percentile of each, and the paper's figures apart."""
    order = sorted(taken, key=lambda name: float(np.median(taken[name])))
    colours = {True: "#c0563b", False: "#33658a"}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 0.27 * (len(order) + len(PAPER_US)) + 1.0), layout="constrained")
        axes = figure.subplots()
        for place, name in enumerate(order):
            low, middle, high = np.percentile(taken[name], [1, 50, 99])
            colour = colours[name in NETWORKS or "PyTorch" in name]
            axes.plot([low, high], [place, place], color=colour, lw=3, alpha=0.35, solid_capstyle="butt")
            axes.plot(middle, place, "o", color=colour, ms=5)
            axes.annotate(
                f"{middle:.1f}" if middle < 10 else f"{middle:.0f}",
                (high, place),
                (5, -3),
                textcoords="offset points",
                fontsize=8,
            )
        for place, value in enumerate(PAPER_US.values(), len(order)):
            axes.plot(value, place, "D", mfc="none", color="#777777", ms=5)
            axes.annotate(
                f"{value:g}", (value, place), (8, -3), textcoords="offset points", fontsize=8, color="#777777"
            )
        labels = [*order, *(f"paper: {name}" for name in PAPER_US)]
        axes.set_yticks(range(len(labels)), labels)
        axes.axhline(len(order) - 0.5, color="#aaaaaa", lw=0.8)
        axes.axvline(1e6 / RATE_HZ, color="#111111", lw=0.8, ls=":")
        axes.annotate(
            "a sample at 200 Hz",
            (1e6 / RATE_HZ, 0),
            (-4, -3),
            textcoords="offset points",
            fontsize=8,
            ha="right",
        )
        axes.invert_yaxis()
        axes.set(
            xscale="log", xlabel="one update of one vehicle from Python [µs]: median, 1st to 99th percentile"
        )
        figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("reports/latency"), help="folder for the results")
    parser.add_argument("--rounds", type=int, default=100, help=f"turns of {CALLS} calls")
    arguments = parser.parse_args()
    taken = measure(contenders(), arguments.rounds)
    arguments.out.mkdir(parents=True, exist_ok=True)
    chip = float(np.median(taken["att-snn-loihi"]))
    with (arguments.out / "latency.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["estimator", "calls", "median_us", "p99_us", "over_att_snn_loihi"])
        print(f"{'estimator':24}{'median':>12}{'p99':>12}{'over att-snn-loihi':>22}")
        for name in sorted(taken, key=lambda name: float(np.median(taken[name]))):
            middle, high = (float(x) for x in np.percentile(taken[name], [50, 99]))
            writer.writerow([name, taken[name].size, f"{middle:.3f}", f"{high:.3f}", f"{middle / chip:.3f}"])
            print(f"{name:24}{middle:>9.2f} µs{high:>9.2f} µs{middle / chip:>22.2f}")
    draw(taken, arguments.out / "latency.png")
    print(arguments.out / "latency.png")


if __name__ == "__main__":
    main()
