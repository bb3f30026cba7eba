"""Speed of filters and networks: `python -m benchmarks.bench_filters`.

One run on one thread; each number is the best of several repetitions. Peers are VQF's C++ in one call and the
package ahrs. The time of one update of one vehicle is in docs/chip.md.
"""

from collections.abc import Callable

import ahrs
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from vqf import VQF

from estimators import create, names, run

from .timing import spent

RATE_HZ = 200.0
Readings = tuple[NDArray, NDArray]


def best_of(call: Callable[[], object], repetitions: int) -> float:
    """Least CPU time [s]; on one thread that is wall time, less what other processes took."""
    return min(spent(call)[1] for _ in range(repetitions))


def random_motion(flights: int, seconds: float) -> Readings:
    """Smooth random rates and a noisy specific force; what they are hardly matters to the speed."""
    rng, steps = np.random.default_rng(0), round(seconds * RATE_HZ)
    t = np.arange(steps) / RATE_HZ
    phase = rng.uniform(0.0, 2.0 * np.pi, (flights, 1, 3))
    gyro = 0.3 * np.cos(2.0 * t[None, :, None] + phase) + rng.normal(0.0, 0.005, (flights, steps, 3))
    return gyro, np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.1, (flights, steps, 3))


def ns_per_sample(name: str, gyro: NDArray, accel: NDArray, repetitions: int) -> float:
    """Of a batch of sequences."""
    est = create(name, RATE_HZ, vehicle="hummingbird")
    run(est, gyro[:1, :2], accel[:1, :2])
    return best_of(lambda: run(est, gyro, accel), repetitions) / gyro[..., 0].size * 1e9


def measure(flights: int = 16, seconds: float = 100.0) -> pd.DataFrame:
    """Estimators and peers: a sample of a batch, and that over VQF's C++."""
    gyro, accel = random_motion(flights, seconds)
    few = slice(0, 2000)
    cpp = best_of(lambda: VQF(1.0 / RATE_HZ).updateBatch(gyro[0], accel[0]), 5) / gyro.shape[1] * 1e9
    found: dict[str, float] = {}
    for name in names():
        if name != "truth":
            slow = name.endswith("filterpy")
            part = slice(0, 400 if slow else 4000)
            found[name] = ns_per_sample(name, gyro[:, part], accel[:, part], 2 if slow else 5)
    found["*VQF, C++, one call*"] = cpp
    for name, make in (("Mahony", ahrs.filters.Mahony), ("Madgwick", ahrs.filters.Madgwick)):
        theirs = best_of(lambda make=make: make(gyr=gyro[0, few], acc=accel[0, few], frequency=RATE_HZ), 2)
        found[f"*ahrs, {name}*"] = theirs / len(gyro[0, few]) * 1e9
    return pd.DataFrame({"run_ns": found}).assign(run_over_vqf=lambda table: table["run_ns"] / cpp)


if __name__ == "__main__":
    print(measure().round(2))
