"""Jobs that take turns, so that a machine that slows down for a while slows all of them."""

import time
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray


def spent(work: Callable[[], object]) -> tuple[float, float]:
    """Wall time, and CPU time of all threads [s]."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def in_turns(jobs: Mapping[str, Callable[[], tuple[float, float]]], rounds: int) -> dict[str, NDArray]:
    """Wall and CPU time (rounds, 2) [s] of jobs, each of which says what it took."""
    turns = [[job() for job in jobs.values()] for _ in range(rounds)]
    return dict(zip(jobs, np.array(turns).transpose(1, 0, 2), strict=True))
