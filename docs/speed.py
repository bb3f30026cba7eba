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

from pages import ROOT, load_page, row
from simulated import options

PEERS = ("crazyflow", "rotorpy", "norse", "snntorch")


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
            "steps": table("bench_simulation", "--rounds", rounds),
            "start": table("bench_simulation", "--rounds", "1", out="--cold-start"),
            "estimators": table("bench_filters"),
            "training": table("bench_training", "--rounds", rounds),
            "report": table("bench_report", "--report", Path(tempfile.gettempdir()) / "quadsim-report"),
        }
    )


if __name__ == "__main__":
    main()
