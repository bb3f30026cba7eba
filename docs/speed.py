"""The page speed.md: `OMP_NUM_THREADS=1 python docs/pages.py speed`.

It measures speed on one thread, beside other libraries: `pip install crazyflow rotorpy`.
"""

import os
import sys
from argparse import Namespace
from collections.abc import Sequence
from importlib.util import find_spec

from pages import ROOT, Page, Parts, row

PEERS = ("crazyflow", "rotorpy", "norse", "snntorch")


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
        "steps": table(bench_simulation.measure(given.rounds)),
        "estimators": table(bench_filters.measure()),
        "training": table(bench_training.measure(given.rounds)),
    }
