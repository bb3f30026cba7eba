"""Datasets of simulated flights: generate them over many processes, open, check, summarise and split them."""

import json
import logging
import os
import shutil
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, as_completed
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from . import dataset_store
from .dataset_store import FLIGHTS, Plan, partial_folder, read_attributes
from .flight import FlightConfig
from .ranges import steps_of
from .rotation import quat_rotate, roll_pitch_from_quat
from .runs import CLUSTER_LOST, alone, code_digest, give_up, worker_pool

log = logging.getLogger(__name__)

Progress = Callable[[int, int], None]
BATCH_FLIGHTS = 16  # more gain no speed
BATCH_BYTES = 400e6  # memory that a worker may use for a batch,
SAMPLE_BYTES = 600  # of which a sample of a flight takes this much while it is simulated
ATTEMPTS = 4  # a worker may die this often


def generate(
    config: FlightConfig,
    flights: int,
    duration_s: float,
    out: str | Path,
    seed: int = 0,
    rate_hz: float = 200.0,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> Path:
    """Simulate flights and write them as a labelled Zarr store.

    The files depend on the configuration, the seed and the code alone, not on the number of workers. An
    interrupted run goes on where it stopped when it is called again with the same arguments; a finished one
    returns at once, unless the code has changed since. Worker processes import the caller's main module, so
    a script calls this under `if __name__ == "__main__":`.

    Args:
        config: What is flown.
        flights: Number of flights; flight i has the i-th child of the seed.
        duration_s: Length of each flight [s].
        out: Path of the dataset; grows as `out.partial` until it is whole.
        seed: Seed of everything random.
        rate_hz: Samples per second.
        workers: Processes, by default one for each CPU; 1 stays in this process. With an executor, how many
            workers it has.
        executor: Where to run in place of processes of our own, for instance a Dask client's
            `get_executor()`; its workers need quadsim and the same file system.
        progress: Called with the flights done and their total at the start and after each flight.
        overwrite: Replace another dataset at `out`, finished or not.

    Returns:
        The path of the dataset.

    Raises:
        ValueError: A bad argument, another dataset in the way, or another process that writes it.
        OSError: The dataset cannot be written, or workers keep dying; what is done is kept.
    """
    plan = _plan(config, flights, duration_s, seed, rate_hz)
    workers = _available_cpus() if workers is None else _at_least("workers", workers, 1)
    out = Path(out).expanduser().absolute()
    try:
        with alone(out):
            if _make_way(plan, out, overwrite):
                _fly_all(plan, partial_folder(out), workers, executor, progress)
                dataset_store.finish(partial_folder(out), plan, out)
    except ChildProcessError:
        raise
    except OSError as error:
        raise OSError(
            f"cannot write {out}: {error.strerror or error}; flights done so far are kept"
        ) from error
    return out


def open_dataset(path: str | Path) -> xr.Dataset:
    """Open a dataset; its arrays are read when they are used.

    Args:
        path: A dataset that `generate` wrote.

    Returns:
        Variables over (flight, time, axis | quat_axis | rotor) in SI units, and coordinates per flight, of
        which `valid_steps` and `end_reason` tell how it went: samples from `valid_steps` on repeat the last.

    Every number is compared with its checksum the first time, and again when a file has changed since.

    Raises:
        FileNotFoundError: There is nothing at the path.
        ValueError: Not a dataset, unfinished, damaged or from a newer version.
    """
    path = Path(path).expanduser()
    attributes = read_attributes(path)
    with dataset_store.damage_in_words(path):
        dataset_store.refuse_truncated(path, attributes)
        dataset = xr.open_dataset(path, engine="zarr", chunks=None, consolidated=True)
        dataset = dataset.set_coords(dataset_store.PER_FLIGHT)
        strings = [name for name, values in dataset.coords.items() if values.dtype.kind not in "if"]
        dataset = dataset.assign_coords({name: dataset[name].astype(object) for name in strings})
        dataset_store.refuse_damaged(path, attributes, dataset)
    return dataset


def verify(path: str | Path, progress: Progress | None = None) -> int:
    """Read every number of a dataset, recompute the checksums and look for numbers that are not finite.

    Returns:
        How many flights were verified.

    Raises:
        ValueError: The damaged flights, each with the first thing wrong with it.
    """
    path = Path(path).expanduser()
    total = read_attributes(path).flights
    damage = {}
    for flight in range(total):
        if fault := dataset_store.fault(path, flight):
            damage[flight] = fault
        if progress:
            progress(flight + 1, total)
    if damage:
        faults = ", ".join(f"flight {flight} ({fault})" for flight, fault in damage.items())
        raise ValueError(f"{path}: {len(damage)} of {total} flights are damaged: {faults}")
    return total


def dataset_info(path: str | Path) -> dict[str, object]:
    """Summary of a dataset, over the samples flown; keys end in their unit.

    Returns:
        Size, rate, seed and configuration, and how widely it flew: standard deviation of roll and of pitch
        over all samples, largest tilt, body rate and speed.

    Raises:
        ValueError: Not a dataset, or one without a single valid sample.
    """
    path = Path(path).expanduser()
    dataset = open_dataset(path)
    samples = int(dataset["valid_steps"].sum())
    if not samples:
        raise ValueError(
            f"{path}: none of {dataset.sizes['flight']} flights has a valid sample; the first: "
            f"{dataset['end_reason'].to_numpy()[0]}. Is a number of the configuration too large?"
        )
    tilt, rate, speed, angles = [], [], [], []
    for flight in range(dataset.sizes["flight"]):
        one = dataset.isel(flight=flight, time=slice(int(dataset["valid_steps"][flight])))
        quat = one["quat"].to_numpy().astype(float)
        angles.append(roll_pitch_from_quat(quat))
        tilt.append(np.arccos(quat_rotate(quat, (0.0, 0.0, 1.0))[:, 2].clip(-1, 1)).max(initial=0))
        rate.append(np.linalg.norm(one["ang_vel"], axis=-1).max(initial=0))
        speed.append(np.linalg.norm(one["velocity"], axis=-1).max(initial=0))
    roll_sd, pitch_sd = np.std(np.concatenate(angles), axis=0)
    return {
        "path": str(path),
        "flights": dataset.sizes["flight"],
        "flights_ended_early": int((dataset["end_reason"] != "").sum()),
        "duration_s": dataset.attrs["duration_s"],
        "rate_hz": dataset.attrs["rate_hz"],
        "samples": samples,
        "roll_sd_deg": float(np.degrees(roll_sd)),
        "pitch_sd_deg": float(np.degrees(pitch_sd)),
        "max_tilt_deg": float(np.degrees(max(tilt))),
        "max_rate_deg_s": float(np.degrees(max(rate))),
        "max_speed_m_s": float(max(speed)),
        "size_MB": float(dataset["stored_bytes"].sum()) / 1e6,
        "seed": dataset.attrs["seed"],
        "quadsim_version": dataset.attrs["quadsim_version"],
        "config": json.loads(dataset.attrs["config"]),
    }


def split_flights(
    n: int, seed: int = 0, fractions: tuple[float, float, float] = (0.7, 0.2, 0.1)
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Split flights at random into training, validation and test sets, none of them empty.

    Args:
        n: Number of flights, at least 3.
        seed: Seed of the shuffle.
        fractions: Shares of the three sets; they add up to 1.

    Returns:
        Numbers of the flights of each set, ascending.
    """
    _at_least("flights", n, 3)
    if min(fractions) <= 0 or abs(sum(fractions) - 1) > 1e-9:
        raise ValueError(f"fractions = {fractions}: three positive shares that add up to 1 are allowed")
    validation = min(max(1, round(n * fractions[1])), n - 2)
    test = min(max(1, round(n * fractions[2])), n - validation - 1)
    shuffled = np.random.default_rng(seed).permutation(n)
    train, rest = np.split(shuffled, [n - validation - test])
    return np.sort(train), np.sort(rest[:validation]), np.sort(rest[validation:])


def _plan(config: FlightConfig, flights: int, duration_s: float, seed: int, rate_hz: float) -> Plan:
    return Plan(
        quadsim_version=version("quadsim"),
        seed=_at_least("seed", seed, 0),
        flights=int(FLIGHTS.of("flights", _at_least("flights", flights, 1))),
        steps=steps_of(duration_s, rate_hz),
        rate_hz=rate_hz,
        code=code_digest("quadsim.dataset_store"),
        config=config,
    )


def _at_least(name: str, value: int, lowest: int) -> int:
    if int(value) != value or value < lowest:
        raise ValueError(f"{name} = {value}: a whole number from {lowest} on is allowed")
    return int(value)


def _available_cpus() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _make_way(plan: Plan, out: Path, overwrite: bool) -> bool:
    """Prepare the unfinished dataset, new or to be continued; False if the finished one is there already.

    Raises:
        ValueError: Another dataset, or something else, is in the way.
    """
    folder = partial_folder(out)
    if out.exists():
        attributes = read_attributes(out)  # refuses to touch what is not a dataset
        if not overwrite:
            dataset_store.refuse_truncated(out, attributes)
            found = attributes.model_dump(include=set(Plan.model_fields))
            _refuse_other(plan, {**found, "config": json.loads(attributes.config)}, f"{out} holds")
            shutil.rmtree(folder, ignore_errors=True)
            return False
    if folder.exists():
        if not (folder / "flights").is_dir():
            raise ValueError(f"{folder} is in the way and not from quadsim: move it, or choose another --out")
        text = dataset_store.read_plan(folder)
        if text == plan.model_dump_json():
            return True
        if text and not overwrite:
            _refuse_other(plan, json.loads(text), f"{out} is unfinished and holds")
        shutil.rmtree(folder)
    dataset_store.begin(folder, plan)
    return True


def _refuse_other(plan: Plan, other: dict[str, object], what: str) -> None:
    """Name the first setting in which a dataset differs from the plan, if there is one."""
    wanted, found = _flat(plan.model_dump(mode="json")), _flat(other)
    for key in sorted(wanted.keys() | found.keys(), key=lambda name: (name == "code", name)):
        if wanted.get(key) != found.get(key):
            differs = f"{key} is {found.get(key)}, not {wanted.get(key)}"
            raise ValueError(
                f"{what} another dataset ({'it was made by other code' if key == 'code' else differs}): "
                "choose another --out, or --overwrite it"
            )


def _flat(tree: object, prefix: str = "") -> dict[str, object]:
    """Leaves of nested dictionaries by dotted key."""
    if not isinstance(tree, dict):
        return {prefix: tree}
    return {
        name: leaf
        for key, value in tree.items()
        for name, leaf in _flat(value, f"{prefix}.{key}" if prefix else key).items()
    }


def _fly_all(
    plan: Plan, folder: Path, workers: int, executor: Executor | None, progress: Progress | None
) -> None:
    """Fly what is missing; a pool of ours whose worker died is replaced, a few times."""
    for attempt in range(ATTEMPTS):
        whole = dataset_store.whole_flights(folder)
        missing = [flight for flight in range(plan.flights) if flight not in whole]
        batches = _batches(missing, plan.steps, workers)
        done = plan.flights - len(missing)
        if progress:
            progress(done, plan.flights)
        try:
            with closing(_fly(plan, folder, batches, workers, executor)) as finished:
                for batch in finished:
                    for _ in batch:
                        done += 1
                        if progress:
                            progress(done, plan.flights)
            return
        except BrokenExecutor as error:
            if executor is not None or attempt == ATTEMPTS - 1:
                raise ChildProcessError(
                    f"worker processes keep dying (out of memory, or killed); {done} of {plan.flights} "
                    "flights are kept: rerun to resume, with fewer workers"
                ) from error
            log.warning("a worker process died; starting again with the flights that are missing")


def _batches(flights: list[int], steps: int, workers: int) -> list[list[int]]:
    """Share flights out in batches that are alike in size, fit in memory and occupy every worker."""
    if not flights:
        return []
    largest = int(np.clip(BATCH_BYTES // (steps * SAMPLE_BYTES), 1, BATCH_FLIGHTS))
    rounds = -(-len(flights) // (largest * workers))
    parts = np.array_split(flights, min(len(flights), rounds * workers))
    return [part.tolist() for part in parts]


def _fly(
    plan: Plan, folder: Path, batches: list[list[int]], workers: int, executor: Executor | None
) -> Generator[Sequence[int], None, None]:
    """Fly batches wherever they are to be flown; yields each one when its flights are whole."""
    if executor is not None:
        yield from _completed(executor, plan, folder, batches)
    elif min(workers, len(batches)) <= 1:
        for batch in batches:
            yield dataset_store.fly_batch(plan, folder, batch)
    else:
        with worker_pool(min(workers, len(batches))) as pool:
            yield from _completed(pool, plan, folder, batches)


def _completed(
    executor: Executor, plan: Plan, folder: Path, batches: list[list[int]]
) -> Iterator[Sequence[int]]:
    futures = [executor.submit(dataset_store.fly_batch, plan, folder, batch) for batch in batches]
    try:
        for future in as_completed(futures):
            yield future.result()
    except CancelledError as error:
        raise ChildProcessError(CLUSTER_LOST) from error
    finally:
        give_up(executor, futures)
