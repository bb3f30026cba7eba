"""Latency of one update of one vehicle, for every estimator, PyTorch's networks beside them.

    python benchmarks/bench_latency.py [--out FOLDER]

The measurement is `estimators.analysis.latency`. It also times the host's part of
att-snn-loihi: scaled readings and the currents of the encoding layer. Writes latency.csv and latency.png
(after the paper's Fig. 9).
"""

import argparse
import csv
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numba import njit
from numpy.typing import NDArray

from estimators.analysis.latency import CALLS, PAPER_US, RATE_HZ, Update, contenders, measure, point
from estimators.networks.encoder import ENCODER, encode_sample
from estimators.networks.network import OnLoihi, create_network, drive, host_and_chip, loihi_state
from quadsim.dataset.figures import STYLE
from quadsim.runs.block import vector, zero_blocks

HOST = "att-snn-loihi, host alone"


@njit(cache=True)
def _on_host(gyro, accel, network, states):
    host, _ = host_and_chip(network)
    encoder, state = vector(states[0], 0, ENCODER)[0], loihi_state(states[0])
    encode_sample(gyro[0], accel[0], host, encoder)
    drive(encoder.inputs, host, state.current, state.bias, np.zeros(state.current.size, np.int32))


def host_part() -> Update:
    """What the host does in one update of att-snn-loihi."""
    core = create_network("att-snn-loihi", RATE_HZ).core
    assert isinstance(core, OnLoihi)
    network, states = core.network, zero_blocks(1, core.state)
    return lambda gyro, accel: _on_host(gyro, accel, network, states)


def every_contender() -> dict[str, Update]:
    """All estimators, PyTorch's networks, and the host's part of the chip's network."""
    return contenders() | {HOST: host_part()}


def draw(taken: dict[str, NDArray[np.float64]]) -> Figure:
    """Median and 99th percentile of each; apart the paper's figures, of its recurrent layer alone."""
    order = sorted(taken, key=lambda name: float(np.median(taken[name])))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 0.27 * (len(order) + len(PAPER_US)) + 1.0), layout="constrained")
        axes = figure.subplots()
        for place, name in enumerate(order):
            low, middle, high = np.percentile(taken[name], [1, 50, 99])
            style = point(name)
            axes.plot([low, high], [place, place], c=style["color"], lw=3, alpha=0.35, solid_capstyle="butt")
            axes.plot(middle, place, ls="", ms=6, **style)
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
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("reports/latency"), help="folder for the results")
    parser.add_argument("--rounds", type=int, default=100, help=f"turns of {CALLS} calls")
    arguments = parser.parse_args()
    taken = measure(every_contender(), arguments.rounds)
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
    draw(taken).savefig(arguments.out / "latency.png", dpi=130)
    print(arguments.out / "latency.png")


if __name__ == "__main__":
    main()
