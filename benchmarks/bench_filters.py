"""Speed of the filters and networks: per streamed sample, per sample of a sequence, and against peers.

    python -m benchmarks.bench_filters [--out speed.csv] [--tuning mahony ...]

All numbers come from one run on one thread; each is the best of several repetitions. Peers are VQF's C++ in
one call, the package ahrs, and PyTorch's GRU. With --tuning also the time of one swarm of 100 particles × 50
iterations on 35 flights of 100 s, the paper's, on two threads: wall and CPU time.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import ahrs
import numpy as np
import torch
import xarray as xr
from vqf import VQF

from estimators import create, names, run
from estimators.networks.weights_file import load_network
from estimators.tuning.search import FlightSelection, SearchSettings, tune

from .table import show

RATE_HZ = 200.0


def best_of(call: Callable[[], object], repetitions: int) -> float:
    """Least CPU time [s]; on one thread that is wall time, less what other processes took."""
    times = []
    for _ in range(repetitions):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return min(times)


def motion(flights: int, seconds: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Smooth random rates and a noisy specific force; what they are hardly matters to the speed."""
    rng, steps = np.random.default_rng(seed), round(seconds * RATE_HZ)
    t = np.arange(steps) / RATE_HZ
    phase = rng.uniform(0.0, 2.0 * np.pi, (flights, 1, 3))
    gyro = 0.3 * np.cos(2.0 * t[None, :, None] + phase) + rng.normal(0.0, 0.005, (flights, steps, 3))
    accel = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.1, (flights, steps, 3))
    return gyro, accel


def ns_per_sample(name: str, gyro: np.ndarray, accel: np.ndarray, repetitions: int = 5) -> float:
    est = create(name, RATE_HZ, vehicle="hummingbird")
    run(est, gyro[:1, :2], accel[:1, :2])
    return best_of(lambda: run(est, gyro, accel), repetitions) / gyro[..., 0].size * 1e9


def us_per_update(name: str, gyro: np.ndarray, accel: np.ndarray, count: int) -> float:
    est = create(name, RATE_HZ, vehicle="hummingbird")
    est.reset(1)
    samples = [(gyro[:1, t], accel[:1, t]) for t in range(count)]
    est.update(*samples[0])

    def stream() -> None:
        for sample in samples:
            est.update(*sample)

    return best_of(stream, 3) / count * 1e6


def measure() -> list[dict[str, str]]:
    """Rows of estimators and peers: an update from Python, a sample of a batch, and that over VQF's C++."""
    gyro, accel = motion(16, 100.0)
    few = slice(0, 2000)
    cpp = best_of(lambda: VQF(1.0 / RATE_HZ).updateBatch(gyro[0], accel[0]), 5) / gyro.shape[1] * 1e9
    rows = []

    def add(name: str, streamed: float | None, batch: float) -> None:
        update = "" if streamed is None else f"{streamed:.2f}"
        rows.append(
            {
                "estimator": name,
                "update_us": update,
                "run_ns": f"{batch:.0f}",
                "run_over_vqf": f"{batch / cpp:.2f}",
            }
        )

    for name in names():
        if name == "truth":
            continue
        slow = name.endswith("filterpy")
        part = slice(0, 400 if slow else 4000)
        batch = ns_per_sample(name, gyro[:, part], accel[:, part], 2 if slow else 5)
        add(name, us_per_update(name, gyro, accel, 400 if slow else 10_000), batch)
    add("*VQF, C++, one call*", None, cpp)
    for name, make in (("Mahony", ahrs.filters.Mahony), ("Madgwick", ahrs.filters.Madgwick)):
        theirs = best_of(lambda make=make: make(gyr=gyro[0, few], acc=accel[0, few], frequency=RATE_HZ), 2)
        add(f"*ahrs, {name}*", None, theirs / 2000 * 1e9)
    add("*PyTorch, the GRU of att-rnn, 16 sequences*", None, torch_gru(gyro[:, few], accel[:, few]))
    return rows


def torch_gru(gyro: np.ndarray, accel: np.ndarray) -> float:
    """Nanoseconds a sample of PyTorch's GRU with the sizes of att-rnn, its inputs scaled already."""
    torch.set_num_threads(1)
    network = torch.nn.GRU(6, load_network("att-rnn")[0].hidden, num_layers=2, batch_first=True)
    x = torch.tensor(np.concatenate([gyro, accel], axis=-1), dtype=torch.float32)
    with torch.no_grad():
        network(x[:, :10])
        return best_of(lambda: network(x), 5) / gyro[..., 0].size * 1e9


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, help="also write the table as CSV")
    parser.add_argument("--tuning", nargs="*", metavar="FILTER", help="time a swarm on 3500 s of flight")
    arguments = parser.parse_args()
    show("estimators", measure(), arguments.out)
    if arguments.tuning is not None:
        time_tuning(arguments.tuning or ["mahony", "ekf", "eskf"])


def time_tuning(filters: list[str]) -> None:
    gyro, accel = motion(35, 100.0)
    dims = ("flight", "time", "axis")
    quat = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*gyro.shape[:2], 4))
    variables = {"gyro": (dims, gyro), "accel": (dims, accel), "quat": (("flight", "time", "quat"), quat)}
    dataset = xr.Dataset(variables, attrs={"rate_hz": RATE_HZ})
    print()
    for name in filters:
        tune(name, [dataset], SearchSettings(particles=2, iterations=1), FlightSelection(1))  # compiles
        wall, cpu = time.perf_counter(), time.process_time()
        tune(name, [dataset], workers=2)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        print(f"tuning {name}, 100 × 50 on 3500 s, two threads: {wall:.0f} s, of CPU time {cpu:.0f} s")


if __name__ == "__main__":
    main()
