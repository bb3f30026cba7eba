"""Mutated files of every kind: each is taken, or refused in one line, in bounded time and memory.

    python benchmarks/fuzz.py [--cases 10000] [--seed 0] [--only ulog] [--case 123]

A case is a whole sample file with a few mutations drawn from the seed and its number: bytes flipped, cut,
repeated or inserted, and in TOML and JSON hostile values in place of single ones. What is taken is used: a
scenario flies, weights estimate, a dataset is summarised. A case fails with any error but one line of
ValueError or OSError, above 2 GB of memory, or after 10 s. Exit status 1 if any fails; `--case` runs a single
one and shows its error.
"""

import argparse
import copy
import json
import multiprocessing
import random
import resource
import shutil
import sys
import tempfile
import time
import tomllib
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from rich.progress import track
from rich.table import Table
from ulog_file import write_ulog

import estimators
from estimators.networks.weights_file import load_network
from estimators.tuned import load_tuning
from quadsim.config.toml import preset_names, shipped_folder
from quadsim.dataset.export import export
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import dataset_info, open_dataset
from quadsim.external import load_external
from quadsim.flight.mission import Mission
from quadsim.flight.recipe import flight_config, load_recipe
from quadsim.flight.scenario import Scenario, load_scenario
from quadsim.flight.simulate import FlightConfig
from quadsim.imu.spec import load_imu
from quadsim.logs import read_log_and_report
from quadsim.runs.console import output
from quadsim.runs.fingerprint import ASSETS
from quadsim.seeding import vehicle_seeds
from quadsim.vehicle import load_vehicle
from scenarios.bench.runner import bench, load_results
from scenarios.bench.settings import FlightSettings, ScenarioChanges
from scenarios.report.publish import publish

LIMIT_S, LIMIT_BYTES = 10.0, 2e9
FLOWN = 20
"""Samples for which an accepted scenario is simulated."""
HOSTILE = (
    0, -1, 1, 1e9, -1e9, 1e300, 5e-324, 1e-12, float("inf"), float("nan"), 2**63, True, False, "", "x",
    "../x", "/dev/zero", "<b>", "\x00", "\U0001f681", [], [[]], {}, [1e300] * 3, [0.0, 0.0, 0.0],
    [-1.0, -1.0, -1.0],
)  # fmt: skip


@dataclass
class Outcome:
    """What became of a case."""

    kind: str
    number: int
    taken: bool = False
    failure: str = ""
    seconds: float = 0.0
    peak_mb: float = 0.0


# --- samples ----------------------------------------------------------------------------------------


def make_samples(folder: Path) -> None:
    """A whole file, or folder, of every kind."""
    whole = generate(flight_config(load_recipe("hummingbird")), 1, 1.0, folder / "flights.zarr", workers=1)
    export(whole, folder / "bag", "rosbag2")
    export(whole, folder / "euroc", "csv")
    data = open_dataset(whole)
    gyro, accel, quat = (data[name].to_numpy()[0].astype(float) for name in ("gyro", "accel", "quat"))
    stamps = np.arange(len(gyro)) * 5000 + 1_000_000
    write_ulog(
        folder / "log.ulg",
        {
            "sensor_combined": (
                "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;",
                stamps,
                np.concatenate([gyro, accel], axis=1) * np.tile([1.0, -1.0, -1.0], 2),
            ),
            "vehicle_attitude": ("uint64_t timestamp;float[4] q;", stamps, quat),
        },
    )
    (folder / "csv").mkdir()
    rows = np.column_stack([stamps * 1e-6, gyro, accel, quat])
    header = "t,p,q,r,x,y,z,qw,qx,qy,qz"
    np.savetxt(folder / "csv" / "log.csv", rows, "%.6g", delimiter=",", header=header, comments="")
    (folder / "csv" / "log.toml").write_text(
        'file = "log.csv"\n[time]\ncolumn = "t"\n[gyro]\ncolumns = ["p", "q", "r"]\n'
        '[accel]\ncolumns = ["x", "y", "z"]\n[quat]\ncolumns = ["qw", "qx", "qy", "qz"]\n'
    )
    np.savez(folder / "trial.npz", t=stamps * 1e-6, imu_gyr=gyro, imu_acc=accel, opt_quat=quat)
    changes = ScenarioChanges(duration_s=0.5)
    bench(["hover"], ["truth", "mahony"], folder / "bench", FlightSettings(), changes, workers=1)
    for name in ("att-snn", "att-rnn"):
        source = ASSETS / "weights" / f"{name}.safetensors"
        (folder / f"{name}.safetensors").write_bytes(source.read_bytes())


# --- mutations --------------------------------------------------------------------------------------


def mutated_bytes(content: bytes, draw: random.Random) -> bytes:
    """A few bytes flipped, cut, repeated, inserted or overwritten."""
    found = bytearray(content)
    for _ in range(draw.choice((1, 1, 2, 4, 16))):
        at = draw.randrange(len(found) + 1)
        length = draw.choice((1, 2, 4, 8, 64, 1024))
        match draw.randrange(6):
            case 0 if at < len(found):
                found[at] ^= 1 << draw.randrange(8)
            case 1:
                del found[at : at + length]
            case 2:
                found[at:at] = found[at : at + length] * draw.choice((1, 2, 100))
            case 3:
                found[at:at] = draw.randbytes(length)
            case 4:
                found[at : at + 8] = draw.choice((b"\xff" * 8, bytes(8), b"\x00\x00\x00\x00\x00\x00\xf0\x7f"))
            case _:
                del found[at:]
    return bytes(found)


def mutated_tree(tree: Any, draw: random.Random) -> Any:
    """One value of nested tables and lists replaced, left out, renamed or nested deeply."""
    places = list(_places(tree))
    if not places:
        return copy.deepcopy(draw.choice(HOSTILE))
    owner, key = draw.choice(places)
    match draw.randrange(8):
        case 0:
            del owner[key]
        case 1 if isinstance(owner, dict):
            owner[f"{key}x"] = owner.pop(key)
        case 2:
            deep: Any = 1
            for _ in range(draw.choice((3, 60, 300))):
                deep = [deep] if draw.random() < 0.5 else {"a": deep}
            owner[key] = deep
        case 3 if isinstance(owner[key], int | float) and not isinstance(owner[key], bool):
            owner[key] = draw.choice((-owner[key], owner[key] * 1e3, owner[key] * 1e-6, owner[key] + 1))
        case 4 if isinstance(owner[key], list) and owner[key]:
            owner[key] = owner[key] * draw.choice((0, 2, 50))
        case _:
            owner[key] = copy.deepcopy(draw.choice(HOSTILE))
    return tree


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    waiting = [tree]
    while waiting:
        each = waiting.pop()
        if isinstance(each, dict | list):
            for key, value in each.items() if isinstance(each, dict) else enumerate(each):
                yield each, key
                waiting.append(value)


def mutated_text(text: str, draw: random.Random, read: Callable, write: Callable) -> bytes:
    """A text of tables, mutated as a tree or as bytes."""
    if draw.random() < 0.35:
        return mutated_bytes(text.encode(), draw)
    tree = read(text)
    for _ in range(draw.choice((1, 1, 1, 3))):
        tree = mutated_tree(tree, draw)
    try:
        return write(tree).encode()
    except (TypeError, ValueError, RecursionError, AttributeError):  # a tree that the format cannot hold
        return mutated_bytes(text.encode(), draw)


def mutate_a_file(folder: Path, draw: random.Random) -> None:
    """One file below a folder."""
    path = draw.choice(sorted(each for each in folder.rglob("*") if each.is_file()))
    if path.suffix == ".json":
        path.write_bytes(mutated_text(path.read_text("utf-8"), draw, json.loads, json.dumps))
    elif path.suffix == ".toml":
        path.write_bytes(mutated_text(path.read_text("utf-8"), draw, tomllib.loads, tomli_w.dumps))
    else:
        path.write_bytes(mutated_bytes(path.read_bytes(), draw))


# --- what is done with a mutated file ---------------------------------------------------------------


def fly(scenario: Scenario) -> None:
    """Two vehicles for a few samples."""
    mission = Mission(scenario, estimators.create("mahony"), 2, 200.0)
    mission.begin(vehicle_seeds(0, 2))
    for _ in range(min(FLOWN, mission.steps)):
        mission.step()


def toml(samples: Path, work: Path, draw: random.Random) -> None:
    """A preset of any kind."""
    kind = draw.choice(("vehicles", "imus", "externals", "scenarios", "recipes", "tuning"))
    name = draw.choice(preset_names(kind))
    source = shipped_folder(kind) / f"{name}.toml"
    path = work / f"{name}.toml"
    path.write_bytes(mutated_text(source.read_text(encoding="utf-8"), draw, tomllib.loads, tomli_w.dumps))
    base = Scenario(description="", duration_s=1.0)
    match kind:
        case "vehicles":
            load_vehicle(path)
            fly(base.model_copy(update={"vehicle": str(path)}))
        case "imus":
            load_imu(path)
            fly(base.model_copy(update={"imu": str(path)}))
        case "externals":
            load_external(path)
            fly(base.model_copy(update={"external": str(path)}))
        case "scenarios":
            fly(load_scenario(path))
        case "recipes":
            config: FlightConfig = flight_config(load_recipe(path))
            dataset_info(generate(config, 1, 0.1, work / "x.zarr", workers=1))
        case _:
            for filter_name in load_tuning(path):
                estimators.create(filter_name, 200.0, tuning=path, vehicle="hummingbird")


def weights(samples: Path, work: Path, draw: random.Random) -> None:
    """A network: its header as JSON, or any of its bytes."""
    path = work / "x.safetensors"
    content = (samples / f"{draw.choice(('att-snn', 'att-rnn'))}.safetensors").read_bytes()
    size = int.from_bytes(content[:8], "little")
    if draw.random() < 0.6:
        header = json.loads(content[8 : 8 + size])
        if draw.random() < 0.7:
            inner = json.loads(header["__metadata__"]["config"])
            header["__metadata__"]["config"] = json.dumps(mutated_tree(inner, draw))
        else:
            header = mutated_tree(header, draw)
        changed = json.dumps(header).encode()
        path.write_bytes(len(changed).to_bytes(8, "little") + changed + content[8 + size :])
    else:
        path.write_bytes(mutated_bytes(content, draw))
    load_network(path)
    est = estimators.create(str(path), 200.0)
    est.reset(2)
    for _ in range(3):
        est.update(np.zeros((2, 3)), np.tile([0.0, 0.0, 9.81], (2, 1)))


def zarr(samples: Path, work: Path, draw: random.Random) -> None:
    """A dataset."""
    path = Path(shutil.copytree(samples / "flights.zarr", work / "x.zarr"))
    mutate_a_file(path, draw)
    open_dataset(path).load()
    dataset_info(path)


def ulog(samples: Path, work: Path, draw: random.Random) -> None:
    """A PX4 log."""
    path = work / "x.ulg"
    path.write_bytes(mutated_bytes((samples / "log.ulg").read_bytes(), draw))
    read_log_and_report(path)[1].warnings  # noqa: B018  (worked out when it is asked for)


def csv(samples: Path, work: Path, draw: random.Random) -> None:
    """A CSV with its column map, or an EuRoC folder."""
    if draw.random() < 0.6:
        folder = Path(shutil.copytree(samples / "csv", work / "csv"))
        path = folder / "log.toml"
    else:
        folder = path = Path(shutil.copytree(next((samples / "euroc").iterdir()), work / "euroc"))
    mutate_a_file(folder, draw)
    read_log_and_report(path)


def bag(samples: Path, work: Path, draw: random.Random) -> None:
    """A ROS bag, or a trial in NumPy's format."""
    if draw.random() < 0.3:
        path = work / "x.npz"
        path.write_bytes(mutated_bytes((samples / "trial.npz").read_bytes(), draw))
    else:
        bags = [each for each in (samples / "bag").rglob("metadata.yaml")]
        path = Path(shutil.copytree(bags[0].parent, work / "bag"))
        mutate_a_file(path, draw)
    read_log_and_report(path)


def report(samples: Path, work: Path, draw: random.Random) -> None:
    """The folder of a benchmark, reported again."""
    folder = Path(shutil.copytree(samples / "bench", work / "bench"))
    mutate_a_file(folder, draw)
    publish(folder, load_results(folder))


KINDS = {each.__name__: each for each in (toml, weights, zarr, ulog, csv, bag, report)}


# --- cases ------------------------------------------------------------------------------------------


def run_case(kind: str, number: int, seed: int, samples: Path) -> Outcome:
    """One case, in this process."""
    outcome, began = Outcome(kind, number), time.monotonic()
    with tempfile.TemporaryDirectory(dir=samples.parent) as work:
        try:
            KINDS[kind](samples, Path(work), random.Random(f"{seed} {kind} {number}"))
            outcome.taken = True
        except (ValueError, OSError) as error:
            if "pydantic" in f"{error}":
                outcome.failure = f"a library's own message: {error}"
        except BaseException:  # what a user would see as a traceback, MemoryError too
            outcome.failure = traceback.format_exc()
    outcome.seconds = time.monotonic() - began
    outcome.peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if outcome.peak_mb * 1024**2 > LIMIT_BYTES:
        outcome.failure = outcome.failure or f"{outcome.peak_mb:.0f} MB of memory"
    return outcome


def _worker(pipe: Connection, seed: int, samples: Path) -> None:
    sys.stderr = sys.stdout = open("/dev/null", "w")  # noqa: SIM115  (warnings of libraries about damaged files)
    in_use = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (int(in_use + 2 * LIMIT_BYTES),) * 2)
    while (job := pipe.recv()) is not None:
        pipe.send(run_case(*job, seed, samples))


def run_cases(cases: list[tuple[str, int]], seed: int, samples: Path) -> Iterator[Outcome]:
    """Cases one after the other in a process that is replaced when one of them hangs or kills it."""
    context, worker = multiprocessing.get_context("spawn"), None
    for kind, number in cases:
        if worker is None or not worker.is_alive():
            ours, theirs = context.Pipe()
            worker = context.Process(target=_worker, args=(theirs, seed, samples), daemon=True)
            worker.start()
            theirs.close()
            warm = 300.0  # importing and compiling count for no case
        ours.send((kind, number))
        try:
            if ours.poll(LIMIT_S + warm):
                outcome = ours.recv()
                if not warm and outcome.seconds > LIMIT_S:
                    outcome.failure = outcome.failure or f"{outcome.seconds:.0f} s"
                yield outcome
            else:
                yield Outcome(kind, number, failure=f"no answer after {LIMIT_S:g} s", seconds=LIMIT_S)
                worker.kill()
                worker.join()
        except EOFError:
            worker.join()
            yield Outcome(kind, number, failure=f"the process died (exit code {worker.exitcode})")
        warm = 0.0
    if worker is not None and worker.is_alive():
        ours.send(None)
        worker.join()


def summary(outcomes: list[Outcome]) -> Table:
    """A row a kind."""
    table = Table("kind", "cases", "taken", "refused", "failed", "slowest, s", "peak, MB")
    for kind in KINDS:
        ours = [each for each in outcomes if each.kind == kind]
        if ours:
            failed = sum(bool(each.failure) for each in ours)
            taken = sum(each.taken for each in ours)
            slowest, peak = max(each.seconds for each in ours), max(each.peak_mb for each in ours)
            table.add_row(
                kind, *map(str, (len(ours), taken, len(ours) - taken - failed, failed)),
                f"{slowest:.1f}", f"{peak:.0f}",
            )  # fmt: skip
    return table


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=10_000, help="over all kinds")
    parser.add_argument("--seed", type=int, default=0, help="of the mutations")
    parser.add_argument("--only", choices=list(KINDS), help="one kind alone")
    parser.add_argument("--case", type=int, help="one case, with --only, in this process")
    asked = parser.parse_args()
    kinds = [asked.only] if asked.only else list(KINDS)
    with tempfile.TemporaryDirectory() as folder:
        samples = Path(folder) / "samples"
        make_samples(samples)
        if asked.case is not None:
            output.print(run_case(kinds[0], asked.case, asked.seed, samples))
            return 0
        cases = [(kinds[k % len(kinds)], k // len(kinds)) for k in range(asked.cases)]
        cases.sort(key=lambda case: kinds.index(case[0]))
        found = list(track(run_cases(cases, asked.seed, samples), "fuzz", total=len(cases), transient=True))
    for each in found:
        if each.failure:
            again = f"python benchmarks/fuzz.py --seed {asked.seed} --only {each.kind} --case {each.number}"
            output.print(f"{again}: {each.failure.strip().splitlines()[-1]}", markup=False, soft_wrap=True)
    output.print(summary(found))
    return int(any(each.failure for each in found))


if __name__ == "__main__":
    sys.exit(main())
