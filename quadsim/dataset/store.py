"""Files of a dataset: Zarr with one chunk per flight and variable. A flight is either complete or absent.

A dataset `x.zarr` is first written to `x.zarr.partial`:

    plan.json            the configuration; a run resumes only if its own configuration is the same
    flights/00012.json   written after the chunks of flight 12: its end, and the checksum of its chunks
    data/                the Zarr store, renamed to `x.zarr` when every flight is complete

The chunks depend only on the plan and not on the number of workers, so the finished files are always the
same, byte for byte. The finished store has the checksums of all its files in `checksum/files.json`, which
readers of Zarr ignore.
"""

import json
import shutil
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numcodecs.blosc
import numpy as np
import xarray as xr
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec
from zarr.errors import ZarrUserWarning

from ..flight.recipe import Recipe
from ..flight.simulate import simulate_flights
from ..imu.spec import READINGS
from ..runs.files import write_json, write_whole
from ..runs.fingerprint import content_digest
from ..vehicle import MIN_ROTORS

FORMAT = "quadsim flights"
FORMAT_VERSION = 1
Progress = Callable[[int, int], None]
"""Called as progress(finished flights, all flights)."""
DIGESTS = "checksum/files.json"
COMPRESSION = BloscCodec(cname="lz4", clevel=1, shuffle="bitshuffle", typesize=4)


class Variable(NamedTuple):
    """Description of a variable."""

    dim: str
    """Name of the last dimension, after flight and time."""
    units: str
    long_name: str


VARIABLES = {
    name: Variable("axis", unit, f"{sensor} reading: {quantity} with the errors of the IMU, sensor axes")
    for name, (unit, sensor, quantity) in READINGS.items()
} | {
    "ang_vel": Variable("axis", "rad/s", "true angular rate of the body w.r.t. the world, body axes"),
    "specific_force": Variable("axis", "m/s^2", "true specific force at the centre of mass, body axes"),
    "quat": Variable("quat_axis", "1", "true attitude, body to world, Hamilton, scalar first"),
    "position": Variable("axis", "m", "position of the centre of mass in the world, z up"),
    "velocity": Variable("axis", "m/s", "velocity of the centre of mass in the world, z up"),
    "rotor_vel": Variable("rotor", "rad/s", "rotor speed"),
    "rotor_vel_cmd": Variable("rotor", "rad/s", "rotor speed commanded by the controller"),
    "wind": Variable("axis", "m/s", "velocity of the air in the world, z up"),
}
VARIABLES |= {
    f"{name}_bias": Variable("axis", unit, f"true bias of the {sensor}, sensor axes")
    for name, (unit, sensor, _) in READINGS.items()
}
MEASURED = VARIABLES | {"mag": Variable("axis", "T", "magnetic field in body axes")}
"""Further variables that the dataset of a log may have."""
LABELS = {"axis": ["x", "y", "z"], "quat_axis": ["w", "x", "y", "z"], "rotor": [*map(str, range(MIN_ROTORS))]}
"""Labels of the last dimensions; the dimension rotor has as many labels as the vehicle has rotors."""


PER_FLIGHT = ("valid_steps", "end_reason")
"""Coordinates of each flight."""


class Recorded(NamedTuple):
    """Origin of flights that were recorded instead of simulated."""

    logs: tuple[str, ...]
    """Names of the logs."""
    piece_s: float
    """Length of the pieces that the logs were cut into [s]."""
    unknown: tuple[str, ...]
    """Variables that the logs do not contain, filled with zeros."""


class Plan(NamedTuple):
    """Everything that the numbers of a dataset depend on."""

    quadsim_version: str
    seed: int
    flights: int
    steps: int
    rate_hz: float
    code: str
    """Digest of the simulation code; empty for recorded flights."""
    config: Recipe | Recorded

    @property
    def labels(self) -> dict[str, list[str]]:
        """Labels of the last dimensions."""
        rotors = MIN_ROTORS if isinstance(self.config, Recorded) else len(self.config.vehicle.rotors)
        return LABELS | {"rotor": [*map(str, range(rotors))]}

    @property
    def config_json(self) -> str:
        """The configuration as JSON."""
        if isinstance(self.config, Recorded):
            return json.dumps(self.config._asdict())
        return self.config.model_dump_json()

    @property
    def content(self) -> dict[str, Any]:
        """The plan in types of JSON."""
        return {"format_version": FORMAT_VERSION} | self._asdict() | {"config": json.loads(self.config_json)}

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the finished dataset, with the configuration as JSON."""
        about = {"format": FORMAT} | self.content
        late = {"duration_s": self.steps / self.rate_hz, "code": about.pop("code")}
        return about | late | {"config": self.config_json}


class Record(NamedTuple):
    """What is stored about a complete flight in addition to its chunks."""

    valid_steps: int
    end_reason: str
    digest: str
    """SHA-256 of the bytes of its chunks, in the order of `VARIABLES`."""


def partial_folder(out: Path) -> Path:
    """Return the folder that holds a dataset until it is complete."""
    return out.with_name(out.name + ".partial")


def chunk_file(store: Path, variable: str, flight: int) -> Path:
    """Return the file with one variable of one flight."""
    return store / variable / f"c.{flight}.0.0"


def lay_out(folder: Path, plan: Plan) -> None:
    """Create an empty store; a store without a plan is created again."""
    (folder / "flights").mkdir(parents=True, exist_ok=True)
    group = zarr.open_group(folder / "data", mode="w")
    for name, variable in VARIABLES.items():
        width = len(plan.labels[variable.dim])
        group.create_array(
            name,
            shape=(plan.flights, plan.steps, width),
            chunks=(1, plan.steps, width),
            dtype="float32",
            fill_value=float("nan"),
            compressors=COMPRESSION,
            chunk_key_encoding={"name": "default", "separator": "."},
            dimension_names=("flight", "time", variable.dim),
            attributes={"units": variable.units, "long_name": variable.long_name},
            config={"write_empty_chunks": True},
        )
    write_whole(folder / "plan.json", json.dumps(plan.content))


def read_plan(folder: Path) -> str | None:
    """Return the plan of an unfinished dataset as JSON; None if there is no plan."""
    file = folder / "plan.json"
    return file.read_text(encoding="utf-8") if file.is_file() else None


def fly_batch(plan: Plan, folder: Path, flights: Sequence[int]) -> Sequence[int]:
    """Simulate some flights of a plan and write them. This is the job of a worker.

    Args:
        plan: The plan of the dataset.
        folder: Folder of the unfinished dataset.
        flights: Numbers of the flights.

    Returns:
        The numbers of the flights, which are now complete.
    """
    assert isinstance(plan.config, Recipe)
    seeds = [np.random.SeedSequence(plan.seed, spawn_key=(flight,)) for flight in flights]
    log = simulate_flights(plan.config, seeds, plan.steps, plan.rate_hz)
    values = {name: np.asarray(log[name], dtype="<f4") for name in VARIABLES}
    ends = zip(map(int, log["end_step"]), map(str, log["end_reason"]), strict=True)
    write_flights(folder, flights, values, list(ends))
    return flights


def write_flights(
    folder: Path,
    flights: Sequence[int],
    values: Mapping[str, NDArray[np.float32]],
    ends: Sequence[tuple[int, str]],
) -> None:
    """Write flights, and then the records that mark them as complete.

    Args:
        folder: The unfinished dataset.
        flights: Numbers of the n flights.
        values: Variables, (n, steps, width) each. After its end, a flight repeats its last valid sample.
        ends: Number of valid samples of each flight, and why the flight ended early; empty if it did not.
    """
    store = folder / "data"
    held = [
        _hold_after_end({name: array[row] for name, array in values.items()}, *end)
        for row, end in enumerate(ends)
    ]
    numcodecs.blosc.use_threads = False  # several threads would order the blocks of a chunk by chance
    group = zarr.open_group(store, mode="r+")
    for name, array in values.items():
        stored = group[name]
        assert isinstance(stored, zarr.Array)
        for row, flight in enumerate(flights):
            stored[flight] = array[row]
    for flight, end in zip(flights, held, strict=True):
        record = Record(*end, chunks_digest(store, flight))
        write_whole(folder / "flights" / f"{flight:05d}.json", json.dumps(record._asdict()))


def _hold_after_end(
    values: Mapping[str, NDArray[np.float32]], end_step: int, end_reason: str
) -> tuple[int, str]:
    """Repeat the last valid sample to the end of the array, in place, so that no file contains NaN.

    A flight without a valid sample is filled with zeros and a level attitude.
    """
    finite = np.logical_and.reduce([np.isfinite(array).all(axis=-1) for array in values.values()])
    if not finite[:end_step].all():
        end_step, end_reason = int(np.argmin(finite)), "a number of the simulation is not finite"
    for name, array in values.items():
        if end_step > 0:
            array[end_step:] = array[end_step - 1]
        else:
            array[:] = (1, 0, 0, 0) if name == "quat" else 0
    return end_step, end_reason


def whole_flights(folder: Path) -> dict[int, Record]:
    """Return the records of complete flights by number.

    Flights whose chunks have changed are not complete.
    """
    records = {}
    for file in sorted((folder / "flights").glob("[0-9]*.json")):
        flight = int(file.stem)
        try:
            record = Record(**json.loads(file.read_text(encoding="utf-8")))
            whole = record.digest == chunks_digest(folder / "data", flight)
        except (ValueError, TypeError, FileNotFoundError):
            continue  # cut short by a crash of the machine: the flight is simulated again
        if whole:
            records[flight] = record
    return records


def finish(folder: Path, plan: Plan, out: Path) -> None:
    """Add the coordinates, consolidate the metadata and move the store to its final place."""
    store = folder / "data"
    records = whole_flights(folder)
    _write_coordinates(store, plan, [records[flight] for flight in range(plan.flights)])
    for stray in store.glob("*/*.partial"):  # chunks that a killed worker left half written
        stray.unlink()
    chunks = {chunk_file(store, name, flight) for name in VARIABLES for flight in records}
    others = sorted(file for file in store.rglob("*") if file.is_file() and file not in chunks)
    digests = {
        "flights": [records[flight].digest for flight in range(plan.flights)],
        "others": {file.relative_to(store).as_posix(): content_digest(file.read_bytes()) for file in others},
    }
    write_json(store / DIGESTS, digests)
    if out.exists():
        out.rename(folder / "replaced")
    store.rename(out)
    shutil.rmtree(folder)


def _write_coordinates(store: Path, plan: Plan, records: Sequence[Record]) -> None:
    time = {"units": "s", "long_name": "time since the start of the flight"}
    valid = {"long_name": "valid samples; any later ones repeat the last of them"}
    reason = {"long_name": "why the flight ended early; empty if it lasted its full time"}
    coordinates = {
        "flight": ("flight", np.arange(plan.flights), {"long_name": "number of the flight"}),
        "time": ("time", np.arange(plan.steps) / plan.rate_hz, time),
        "valid_steps": ("flight", np.array([record.valid_steps for record in records]), valid),
        "end_reason": ("flight", np.array([record.end_reason for record in records], object), reason),
    }
    for dim, names in plan.labels.items():
        coordinates[dim] = (dim, np.array(names, object), {"long_name": "component"})
    encoding = {name: {"chunks": values.shape} for name, (_, values, _) in coordinates.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)  # other readers may ignore consolidated metadata
        xr.Dataset(coords=coordinates, attrs=plan.attributes).to_zarr(
            store, mode="a", consolidated=True, zarr_format=3, encoding=encoding
        )


def chunks_digest(store: Path, flight: int) -> str:
    """Return the SHA-256 of the bytes of the chunks of a flight, variable after variable."""
    return files_digest(chunk_file(store, name, flight) for name in VARIABLES)


def files_digest(files: Iterable[Path]) -> str:
    """Return the SHA-256 of the bytes of files."""
    return content_digest(b"".join(file.read_bytes() for file in files))
