"""Latency of one update for one vehicle, for every estimator and the two networks of the paper.

Every call is timed separately. The estimators take turns of 100 calls, so that other load on the computer
affects all of them equally.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from ..registry import create, names

RATE_HZ = 200.0
CALLS = 100
"""Number of calls in a turn."""
LAYERED = ("att-snn-paper", "att-rnn-paper")
"""Networks of layers with the paper's sizes, which are timed in addition to the estimators."""

Update = Callable[[NDArray[np.float64], NDArray[np.float64]], object]


def timed_estimators() -> dict[str, Update]:
    """Return `update` of every estimator except the truth, and of the networks of layers."""
    return {
        name: create(name, RATE_HZ, vehicle="hummingbird").update
        for name in (*names(), *LAYERED)
        if name != "truth"
    }


def update_times(updates: Mapping[str, Update], rounds: int) -> dict[str, NDArray[np.float64]]:
    """Time each call, in turns [µs]."""
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
