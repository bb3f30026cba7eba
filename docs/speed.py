"""Measure speed beside other libraries: `python docs/speed.py` writes speed.md.

The page compares with packages that are no part of an installation: `pip install crazyflow rotorpy`.
"""

import csv
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from pages import ROOT, confirmed, load_page, row
from simulated import options

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


def table(bench: str, *arguments: str | Path, out: str = "--out") -> list[str]:
    """Run a benchmark in a process of its own; the rows that it writes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "speed.csv"
        command = [sys.executable, "-m", f"benchmarks.{bench}", *arguments, out, file]
        subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
        with file.open() as lines:
            return [row(*each.values()) for each in csv.DictReader(lines)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure everything, one benchmark after the other, and write the page."""
    given = options(__doc__, arguments, rounds=(9, "turns of the jobs that are compared"))
    missing = [name for name in PEERS if find_spec(name) is None]
    if missing:
        sys.exit(f"the page compares with {', '.join(missing)}: pip install {' '.join(missing)}")
    page, rounds = load_page("speed"), str(given.rounds)
    page.write(
        {
            "engines": f"{engine_difference():.0e}",
            "steps": table("bench_simulation", "--rounds", rounds),
            "start": table("bench_simulation", "--rounds", "1", out="--cold-start"),
            "estimators": table("bench_filters"),
            "training": table("bench_training", "--rounds", rounds),
            "report": table("bench_report", "--report", Path(tempfile.gettempdir()) / "quadsim-report"),
        }
    )


if __name__ == "__main__":
    main()
