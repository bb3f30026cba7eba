"""The page speed.md: speed beside other libraries, all on one thread.

pip install crazyflow rotorpy   # no part of an installation
OMP_NUM_THREADS=1 python docs/pages.py speed
"""

import os
import sys
from argparse import Namespace
from collections.abc import Sequence
from importlib.util import find_spec

import numpy as np
from pages import ROOT, Page, Parts, confirmed, row

from quadsim.flight.recipe import flight_config, load_recipe
from quadsim.flight.simulate import simulate_flights
from quadsim.seeding import vehicle_seeds

PEERS = ("crazyflow", "rotorpy", "norse", "snntorch")
AGREEMENT = 1e-12
"""Largest difference of the engines in flight, absolute below 1 and relative above."""


def engine_difference(seconds: float = 20.0, n: int = 8) -> float:
    """Largest difference between MuJoCo and the compiled engine in n flights of the Hummingbird."""
    config = flight_config(load_recipe("hummingbird"))
    theirs, ours = (
        simulate_flights(
            config.model_copy(update={"engine": engine}), vehicle_seeds(0, n), round(seconds * 200.0)
        )
        for engine in ("mujoco", "compiled")
    )
    found = [
        np.abs(np.subtract(ours[name], theirs[name])) / np.maximum(1.0, np.abs(theirs[name]))
        for name in ("position", "velocity", "quat", "ang_vel", "gyro", "accel")
    ]
    return confirmed("difference of the engines", float(max(each.max() for each in found)), AGREEMENT)


def table(rows: Sequence[dict[str, object]]) -> list[str]:
    """Rows of a benchmark."""
    return [row(*each.values()) for each in rows]


def values(page: Page, given: Namespace) -> Parts:
    """Measure everything, one benchmark after the other."""
    missing = [name for name in PEERS if find_spec(name) is None]
    if missing or os.environ.get("OMP_NUM_THREADS") != "1":
        sys.exit(f"{', '.join(missing) or 'OMP_NUM_THREADS=1'} is missing: see docs/speed.py")
    sys.path.insert(0, str(ROOT))
    from benchmarks import bench_filters, bench_simulation, bench_training

    return {
        "engines": f"{engine_difference():.0e}",
        "steps": table(bench_simulation.measure(given.rounds)),
        "estimators": table(bench_filters.measure()),
        "training": table(bench_training.measure(given.rounds)),
    }
