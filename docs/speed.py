"""The page speed.md: `OMP_NUM_THREADS=1 python docs/pages.py speed`.

It measures speed on one thread, beside other libraries: `pip install crazyflow rotorpy`. crazyflow needs
`SCIPY_ARRAY_API=1`.
"""

import os
import sys
from argparse import Namespace
from collections.abc import Sequence
from importlib.util import find_spec

from pages import ROOT, Part, Row, Values

PEERS = ("crazyflow", "rotorpy", "norse", "snntorch")
STATED = {
    "bulk: controller, IMU, recording": ("over_raw", 0.25),
    "environment, n = 1": ("over_raw", 1.4),
    "environment, n = 64": ("over_raw", 0.3),
    "imm": ("run_over_vqf", 2.0),
}
"""What a job may take, over a peer; the page is not made if it takes more than half as much again."""


def rows(found: Sequence[dict[str, object]]) -> list[Row]:
    """Rows of a benchmark.

    Raises:
        AssertionError: A stated ratio is missed by more than half.
    """
    for each in found:
        name = str(next(iter(each.values())))
        if name in STATED:
            column, most = STATED[name]
            assert float(str(each[column])) <= 1.5 * most, f"{name}: {column} {each[column]}, stated: {most}"
    return [tuple(each.values()) for each in found]


def speed(part: Part, given: Namespace) -> Values:
    """Measure everything, one benchmark after the other."""
    missing = [name for name in PEERS if find_spec(name) is None]
    if missing or os.environ.get("OMP_NUM_THREADS") != "1":
        sys.exit(f"{', '.join(missing) or 'OMP_NUM_THREADS=1'} is missing: see docs/speed.py")
    sys.path.insert(0, str(ROOT))
    from benchmarks import bench_filters, bench_simulation, bench_training

    return {
        "steps": rows(bench_simulation.measure(given.rounds)),
        "estimators": rows(bench_filters.measure()),
        "training": rows(bench_training.measure(given.rounds)),
    }
