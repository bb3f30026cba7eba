"""The page speed.md: `OMP_NUM_THREADS=1 python docs/pages.py speed`.

It measures speed on one thread, beside other libraries: `pip install crazyflow norse`. crazyflow needs
`SCIPY_ARRAY_API=1`.
"""

import os
import sys
from argparse import Namespace
from importlib.util import find_spec

from pages import ROOT, Part, Values, confirmed

PEERS = ("crazyflow", "norse")
STATED = {
    "bulk: controller, IMU, recording": ("steps", "over_raw", 0.25),
    "environment, n = 1": ("steps", "over_raw", 1.4),
    "environment, n = 64": ("steps", "over_raw", 0.3),
    "imm": ("estimators", "run_over_vqf", 2.0),
}
"""What a job may take, over a peer; the page is not made if it takes more than half as much again."""


def speed(part: Part, given: Namespace) -> Values:
    """Measure everything, one benchmark after the other.

    Raises:
        ValueError: A stated ratio is missed by more than half.
    """
    missing = [name for name in PEERS if find_spec(name) is None]
    if missing or os.environ.get("OMP_NUM_THREADS") != "1":
        sys.exit(f"{', '.join(missing) or 'OMP_NUM_THREADS=1'} is missing: see docs/speed.py")
    sys.path.insert(0, str(ROOT))
    from benchmarks import bench_filters, bench_simulation, bench_training

    found = {"estimators": bench_filters.measure(), "steps": bench_simulation.measure()}
    for name, (table, column, most) in STATED.items():
        confirmed(f"{name}: {column}", found[table].loc[name, column], 1.5 * most)
    estimators, training = found["estimators"].itertuples(name=None), bench_training.measure()
    return {
        "steps": list(found["steps"].itertuples(name=None)),
        "estimators": [(name, f"{ns:.0f}", ratio) for name, ns, ratio in estimators],
        "training": list(training.map("{:.3g}".format).itertuples(name=None)),
    }
