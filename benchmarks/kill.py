"""Long jobs killed at random moments and started again, compared with jobs that ran through.

    python benchmarks/kill.py [--times 20] [--seed 0] [--only bench]

Each job runs once undisturbed. Then, for every kill, it begins in a new folder, gets SIGKILL at a moment
drawn evenly from the time that the undisturbed one took, and runs again to its end. It must then leave the
same files with the same bytes, but for running times, and no half-written file. Exit status 1 if anything
differs.
"""

import argparse
import csv
import hashlib
import io
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from rich.progress import track
from rich.table import Table

from quadsim.runs.console import output
from quadsim.runs.files import PART

QUADSIM = (sys.executable, "-m", "quadsim.cli")
TIMES = {"log.csv": "seconds"}
"""Column of a table that holds running times."""
UNCOMPARED = ("checkpoint.pt",)
"""A checkpoint has the running times of `log.csv` inside."""
TRAINING = ("--epochs", "4", "--set", "batches=6", "--set", "batch_size=4", "--set", "window_s=1.0")


def jobs(data: Path) -> dict[str, tuple[str, ...]]:
    """Arguments of each job, all but --out; `data` is a dataset."""
    return {
        "generate": ("generate", "--flights", "40", "--duration", "60", "--workers", "2"),
        "train": ("train", "--data", str(data), "--preset", "best", *TRAINING),
        "kfold": ("kfold", "--domain", str(data), "--folds", "2", "--workers", "2", *TRAINING),
        "bench": (
            "bench", "--scenario", "hover", "--scenario", "step", "--scenario", "wind-gust",
            "--estimator", "mahony", "--estimator", "ekf", "--estimator", "vqf", "--seeds", "4",
            "--workers", "2",
        ),
        "tune": (
            "tune", "--estimator", "mahony", "--data", str(data), "--particles", "40", "--iterations", "40",
        ),
    }  # fmt: skip


def run_job(arguments: tuple[str, ...], out: Path, kill_after_s: float | None = None) -> float:
    """Run a job, in its own process group, to the end or until it is killed; the seconds that it took.

    Raises:
        ChildProcessError: It failed by itself.
    """
    began = time.monotonic()
    process = subprocess.Popen(
        [*QUADSIM, *arguments, "--out", str(out)],
        cwd=out.parent,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    try:
        _, said = process.communicate(timeout=kill_after_s)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        return time.monotonic() - began
    if process.returncode:
        raise ChildProcessError(f"{' '.join(arguments)}: {said.decode()[-500:]}")
    return time.monotonic() - began


def contents(out: Path) -> dict[str, str]:
    """Digest of every file of a result that holds no running time, hidden files of locks left out."""
    files = sorted(out.rglob("*")) if out.is_dir() else [out]
    return {
        str(file.relative_to(out.parent)): hashlib.sha256(b"".join(_timeless(file, out))).hexdigest()
        for file in files
        if file.is_file() and file.name not in UNCOMPARED
    }


def _timeless(file: Path, out: Path) -> Iterator[bytes]:
    """Content of a file without its running times, and without the name of the folder that it is in."""
    if file.name in TIMES:
        for row in csv.DictReader(io.StringIO(file.read_text("utf-8"))):
            yield repr({key: value for key, value in row.items() if key != TIMES[file.name]}).encode()
    else:
        yield file.read_bytes().replace(str(out.parent).encode(), b"")


def leftovers(folder: Path) -> list[str]:
    """Files half written, or unfinished datasets."""
    return [str(each.relative_to(folder)) for each in folder.rglob(f"*{PART}*")]


def differences(kept: dict[str, str], found: dict[str, str]) -> str:
    """The files that differ, in a line."""
    return ", ".join(sorted(name for name in {*kept, *found} if kept.get(name) != found.get(name)))


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--times", type=int, default=20, help="kills of each job")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--only", help="one job alone")
    asked = parser.parse_args()
    table, failures = Table("job", "undisturbed, s", "killed", "of these before its end", "same bytes"), []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        data = folder / "data.zarr"
        run_job(("generate", "--flights", "6", "--duration", "20", "--seed", "9"), data)
        for name, arguments in jobs(data).items():
            if asked.only not in (None, name):
                continue
            draw, same, killed = random.Random(f"{asked.seed} {name}"), 0, 0
            place = folder / name
            place.mkdir()
            out = place / {"tune": "out.toml", "generate": "out.zarr"}.get(name, "out")
            whole_s = math.inf
            for _ in range(3):  # the first one compiles
                shutil.rmtree(place)
                place.mkdir()
                whole_s = min(whole_s, run_job(arguments, out))
            kept = contents(out)
            for number in track(range(asked.times), name, transient=True):
                shutil.rmtree(place)
                place.mkdir()
                moment = draw.uniform(0.1, 1.0) * whole_s
                killed += run_job(arguments, out, moment) >= moment
                run_job(arguments, out)
                differs = differences(kept, contents(out)) or ", ".join(leftovers(place))
                same += not differs
                if differs:
                    failures.append(f"{name}, kill {number} after {moment:.2f} s: {differs}")
            table.add_row(name, f"{whole_s:.1f}", str(asked.times), str(killed), f"{same} of {asked.times}")
    for line in failures:
        output.print(line, markup=False, soft_wrap=True)
    output.print(table)
    return int(bool(failures))


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
