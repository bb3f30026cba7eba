"""Jobs that take turns, so that a machine that slows down for a while slows all of them."""

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

Row = dict[str, object]
"""Column to value."""


def spent(work: Callable[[], object]) -> tuple[float, float]:
    """Wall time, and CPU time of all threads [s]."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def in_turns(jobs: Mapping[str, Callable[[], tuple[float, float]]], rounds: int) -> dict[str, NDArray]:
    """Wall and CPU time (rounds, 2) [s] of jobs, each of which says what it took."""
    turns = [[job() for job in jobs.values()] for _ in range(rounds)]
    return dict(zip(jobs, np.array(turns).transpose(1, 0, 2), strict=True))


def show(rows: Sequence[Row]) -> None:
    """Print rows under the names of their columns."""
    table = Table(*rows[0])
    for each in rows:
        table.add_row(*map(str, each.values()))
    Console(width=120).print(table)
