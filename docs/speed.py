"""The page speed.md: `OMP_NUM_THREADS=1 python docs/pages.py speed`.

It measures speed on one thread, beside other libraries: `pip install crazyflow norse`. crazyflow needs
`SCIPY_ARRAY_API=1`.
"""

import os
import sys
from argparse import Namespace
from importlib.util import find_spec

import pandas as pd
from pages import ROOT, Part, Values, confirmed

PEERS = ("crazyflow", "norse")
STATED = {
    "bulk: controller, IMU, recording": ("over_raw", 0.25),
    "environment, n = 1": ("over_raw", 1.4),
    "environment, n = 64": ("over_raw", 0.3),
    "imm": ("run_over_vqf", 2.0),
}
"""What a job may take, over a peer; the page is not made if it takes more than half as much again."""


def kept(found: pd.DataFrame) -> pd.DataFrame:
    """A benchmark's table whose stated ratios are kept.

    Raises:
        ValueError: A stated ratio is missed by more than half.
    """
    for name, (column, most) in STATED.items():
        if name in found.index:
            confirmed(f"{name}: {column}", found.loc[name, column], 1.5 * most)
    return found


def speed(part: Part, given: Namespace) -> Values:
    """Measure everything, one benchmark after the other."""
    missing = [name for name in PEERS if find_spec(name) is None]
    if missing or os.environ.get("OMP_NUM_THREADS") != "1":
        sys.exit(f"{', '.join(missing) or 'OMP_NUM_THREADS=1'} is missing: see docs/speed.py")
    sys.path.insert(0, str(ROOT))
    from benchmarks import bench_filters, bench_simulation, bench_training

    estimators = kept(bench_filters.measure())
    training = bench_training.measure().map("{:.3g}".format)
    return {
        "steps": list(kept(bench_simulation.measure()).itertuples(name=None)),
        "estimators": [(name, f"{ns:.0f}", ratio) for name, ns, ratio in estimators.itertuples(name=None)],
        "training": list(training.itertuples(name=None)),
    }
