"""The data of a task, generated once in a folder and read as groups of flights."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from estimators.evaluation.flights import Flights, load_flights, vehicle_of
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.estimator import Readings
from quadsim.flight.recipe import changed_recipe
from quadsim.imu.spec import load_imu
from quadsim.logs import read_log
from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.files import replace
from quadsim.runs.fingerprint import file_digest, fingerprint
from quadsim.vehicle import Vehicle

from .specification import BROAD, ROTORPY, Progress, Task

ENDINGS = (".hdf5", ".mat", ".npz")
"""File suffixes of BROAD's trials; if a trial has several files, the first suffix is used."""


class Group(NamedTuple):
    """Flights with equal length and airframe."""

    names: list[str]
    flights: Flights
    """The flights; the truth is NaN for samples that are not scored."""
    vehicle: Vehicle | None


def make_data(
    task: Task, folder: Path, recordings: Path | None, workers: int | None, progress: Progress
) -> dict[str, str]:
    """Generate missing data of a task; return the digests of the parts, empty for missing parts.

    Args:
        task: The task.
        folder: Folder of the data.
        recordings: The user's folder of BROAD.
        workers: Number of processes, by default one per CPU.
        progress: Called before each part.

    Raises:
        ValueError: The digest of a part differs from that in the task.
    """
    found = {}
    for k, name in enumerate(task.parts):
        progress(k, len(task.parts), name)
        if name == BROAD:
            convert_broad(recordings, folder / name, task.rate_hz)
        elif name == ROTORPY:
            dict(foreign(task, folder, workers))
        else:
            part = task.recipes[name]
            recipe = changed_recipe(part.recipe, part.changes, f"{task.version}: {name}")
            generate(
                recipe, part.flights, part.duration_s, folder / f"{name}.zarr", task.seed_of(name),
                task.rate_hz, workers, overwrite=True, held_out=True,
            )  # fmt: skip
        found[name] = digest_of(groups(task, name, folder))
    progress(len(task.parts), len(task.parts), "")
    return found


def differing(task: Task, digests: Mapping[str, str]) -> list[str]:
    """Return the parts whose data differ from those of the task."""
    return [name for name, digest in task.digests.items() if digest != digests.get(name)]


def digest_of(found: Iterator[Group]) -> str:
    """Return the SHA-256 of readings and true attitudes in single precision; empty without data."""
    digest, some = hashlib.sha256(), False
    for group in found:
        for values in (group.flights.gyro, group.flights.accel, group.flights.quat):
            digest.update(np.ascontiguousarray(values, "<f4").tobytes())
            some = True
    return digest.hexdigest() if some else ""


def groups(task: Task, name: str, folder: Path) -> Iterator[Group]:
    """Return the flights of a part; none of BROAD without the user's folder."""
    if name == BROAD:
        for file in sorted((folder / name).glob("*.npz")):
            yield _trial(file, task.rate_hz)
    elif name == ROTORPY:
        for airframe, dataset in foreign(task, folder):
            yield _group(dataset, task.skip_s, airframe)
    else:
        yield _group(open_dataset(folder / f"{name}.zarr"), task.skip_s, "flight")


def foreign(task: Task, folder: Path, workers: int | None = 1) -> Iterator[tuple[str, xr.Dataset]]:
    """Return flights of RotorPy by airframe."""
    from .rotorpy_flights import AIRFRAMES, plans, rotorpy_flights

    assert task.rotorpy_s is not None
    for k, airframe in enumerate(AIRFRAMES):
        planned, imu = plans(airframe, task.seed_of(ROTORPY) + 10 * k), load_imu("adis16448")
        yield airframe, rotorpy_flights(planned, folder / ROTORPY, imu, task.rotorpy_s, workers)


def convert_broad(source: Path | None, folder: Path, rate_hz: float) -> None:
    """Convert missing trials of BROAD to the rate of the task, with the samples that their authors score.

    Raises:
        ValueError: The folder contains no trial.
    """
    if source is None:
        return
    trials: dict[str, Path] = {}
    for ending in reversed(ENDINGS):
        trials |= {file.stem: file for file in source.expanduser().rglob(f"[0-9][0-9]_*{ending}")}
    if not trials:
        raise ValueError(f"{source}: no trials of BROAD (01_undisturbed_slow_rotation_A.hdf5 and others)")
    for name, file in trials.items():
        digest, made = fingerprint(file_digest(file), rate_hz), folder / f"{name}.npz"
        if made.is_file():
            with np.load(made) as found:
                if str(found["digest"]) == digest:
                    continue
        log = read_log(file, rate_hz).isel(flight=0)
        arrays = {
            key: log[key].to_numpy() for key in ("gyro", "accel", "quat", "scored", "mag") if key in log
        }
        replace(made, lambda part, arrays=arrays, digest=digest: np.savez(part, digest=digest, **arrays))  # pyright: ignore


def _trial(file: Path, rate_hz: float) -> Group:
    with np.load(file) as found:
        arrays = {key: found[key][None] for key in found.files if key != "digest"}
    quat = arrays["quat"]
    truth = np.where(arrays["scored"][..., None], roll_pitch_from_quat(quat), np.nan)
    readings = Readings(arrays["gyro"], arrays["accel"], mag=arrays.get("mag"))
    return Group([file.stem], Flights(readings, quat, truth, rate_hz), None)


def _group(dataset: xr.Dataset, skip_s: float, name: str) -> Group:
    flights = load_flights([dataset])
    flights.truth[:, : round(skip_s * flights.rate_hz)] = np.nan
    by_hand = json.loads(dataset.attrs["config"]).get("hand_held") is not None
    names = [f"{name} {k}" for k in range(len(flights.truth))]
    return Group(names, flights, None if by_hand else vehicle_of(dataset))


def given_start(group: Group) -> Flights:
    """Return flights with a known start: the first known attitude, one sample before the first."""
    attitude = roll_pitch_from_quat(group.flights.quat)
    known = np.isfinite(attitude).all(axis=(0, 2))
    first = int(np.argmax(known))
    return group.flights.map(lambda each: np.ascontiguousarray(each[:, first + 1 :]), attitude[:, first])
