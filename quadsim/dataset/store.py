"""Files of a dataset: one compressed chunk per flight and variable, and a flight is whole or absent.

A dataset `x.zarr` is written beside its final place, in `x.zarr.partial`:

    plan.json            what is being generated; a run continues only the same plan
    flights/00012.json   written after the chunks of flight 12: it is whole; its end, checksum and size
    data/                the Zarr store, renamed to `x.zarr` when every flight is whole

The chunks depend on the plan alone, never on the number of workers, so that the finished files are the same
byte for byte however they came to be. The finished store has the digests of its files in
`checksum/files.json`, where no reader of Zarr looks for arrays.
"""

import hashlib
import json
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numcodecs.blosc
import numpy as np
import zarr
from numcodecs import Blosc
from numpy.typing import NDArray
from platformdirs import user_cache_dir
from pydantic import BaseModel
from zarr.codecs import BloscCodec
from zarr.errors import ZarrUserWarning

from ..config.ranges import Between, SampleRate
from ..config.toml import Strict
from ..flight.simulate import FlightConfig, simulate_flights
from ..imu.spec import ImuSpec
from ..runs.files import PART, read_json, write_json, write_whole
from ..runs.fingerprint import content_digest, fingerprint
from ..vehicle import MIN_ROTORS

FORMAT: Literal["quadsim flights"] = "quadsim flights"
FORMAT_VERSION = 1
CODEC = Blosc(cname="lz4", clevel=1, shuffle=Blosc.BITSHUFFLE, typesize=4)  # writes what
DIGESTS = "checksum/files.json"
COMPRESSION = BloscCodec(cname="lz4", clevel=1, shuffle="bitshuffle", typesize=4)  # declares to readers


class Variable(NamedTuple):
    """What the numbers of a variable are."""

    dim: str
    """Last dimension, after flight and time."""
    units: str
    long_name: str


VARIABLES = {
    "gyro": Variable("axis", "rad/s", "gyroscope reading: body rate with the errors of the IMU, sensor axes"),
    "accel": Variable(
        "axis", "m/s^2", "accelerometer reading: specific force with the errors of the IMU, sensor axes"
    ),
    "ang_vel": Variable("axis", "rad/s", "true angular rate of the body w.r.t. the world, body axes"),
    "specific_force": Variable("axis", "m/s^2", "true specific force at the centre of mass, body axes"),
    "quat": Variable("quat_axis", "1", "true attitude, body to world, Hamilton, scalar first"),
    "position": Variable("axis", "m", "position of the centre of mass in the world, z up"),
    "velocity": Variable("axis", "m/s", "velocity of the centre of mass in the world, z up"),
    "rotor_vel": Variable("rotor", "rad/s", "rotor speed"),
    "rotor_vel_cmd": Variable("rotor", "rad/s", "rotor speed commanded by the controller"),
    "wind": Variable("axis", "m/s", "velocity of the air in the world, z up"),
    "gyro_bias": Variable("axis", "rad/s", "true bias of the gyroscope, sensor axes"),
    "accel_bias": Variable("axis", "m/s^2", "true bias of the accelerometer, sensor axes"),
}
LABELS = {"axis": ["x", "y", "z"], "quat_axis": ["w", "x", "y", "z"], "rotor": [*map(str, range(MIN_ROTORS))]}
"""Labels of the last dimensions; simulated flights have as many rotors as their vehicle."""


PER_FLIGHT = ("valid_steps", "end_reason", "checksum", "stored_bytes")
COORDINATES = (
    {"flight": "flight", "time": "time"} | {dim: dim for dim in LABELS} | dict.fromkeys(PER_FLIGHT, "flight")
)
"""Dimension of each coordinate."""
UNITS = {name: variable.units for name, variable in VARIABLES.items()} | {"time": "s", "stored_bytes": "byte"}
"""Units of the arrays that have one."""


Seed = Annotated[int, Between(0, 2**63 - 1)]
FLIGHTS = Between(1, 10_000_000)
FlightCount = Annotated[int, FLIGHTS]
Samples = Annotated[int, Between(1, 1_000_000_000)]


class Plan(Strict):
    """All that the numbers of a dataset depend on."""

    format_version: Annotated[int, Between(1, 1000)] = FORMAT_VERSION
    quadsim_version: str
    seed: Seed
    flights: FlightCount
    steps: Samples
    rate_hz: SampleRate
    code: str
    """Digest of the code that simulates."""
    config: FlightConfig


class Recorded(Strict):
    """Where flights come from that were recorded, not simulated."""

    logs: tuple[str, ...]
    """Names of the logs."""
    piece_s: Annotated[float, Between(0.0, 1e7, "s")]
    """Length of the pieces that they were cut into [s]."""
    unknown: tuple[str, ...]
    """Variables that no log holds: zeros."""
    imu: ImuSpec = ImuSpec()
    """Unknown: the readings are a real sensor's."""


class RecordedPlan(Strict):
    """What a dataset of recorded flights says of itself."""

    format_version: Annotated[int, Between(1, 1000)] = FORMAT_VERSION
    quadsim_version: str
    seed: Seed = 0
    flights: FlightCount
    steps: Samples
    rate_hz: SampleRate
    code: str = ""
    """None: the numbers are a sensor's."""
    config: Recorded


class Attributes(BaseModel):
    """What a finished dataset says of itself, in the attributes of its Zarr group."""

    format: Literal["quadsim flights"] = FORMAT
    format_version: Annotated[int, Between(1, 1000)] = FORMAT_VERSION
    quadsim_version: str
    seed: Seed
    flights: FlightCount
    steps: Samples
    rate_hz: SampleRate
    duration_s: Annotated[float, Between(0.0, 1e7, "s")]
    code: str = ""
    """Digest of the code that simulated them; empty in datasets of versions without it."""
    config: str
    """The configuration, as JSON."""


class Record(NamedTuple):
    """What is stored of a complete flight beside its chunks."""

    valid_steps: int
    end_reason: str
    checksum: str
    stored_bytes: int
    digest: str
    """SHA-256 over the bytes of its chunks, in the order of `VARIABLES`."""


def partial_folder(out: Path) -> Path:
    """Where a dataset grows until it is whole."""
    return out.with_name(out.name + ".partial")


def _other_files() -> list[str]:
    """Files of a store besides the chunks of flights, and that of their digests."""
    metadata = [f"{name}/zarr.json" for name in (*VARIABLES, *COORDINATES)]
    return ["zarr.json", *metadata, *(f"{name}/c/0" for name in COORDINATES)]


def chunk_file(store: Path, variable: str, flight: int) -> Path:
    """File with one variable of one flight."""
    return store / variable / f"c.{flight}.0.0"


def labels(plan: Plan | RecordedPlan) -> dict[str, list[str]]:
    """Labels of the last dimensions in the dataset of a plan."""
    rotors = len(plan.config.vehicle.rotors) if isinstance(plan, Plan) else MIN_ROTORS
    return LABELS | {"rotor": [*map(str, range(rotors))]}


def begin(folder: Path, plan: Plan | RecordedPlan) -> None:
    """Lay out an empty store; an interrupted one that never got its plan is laid out again."""
    (folder / "flights").mkdir(parents=True, exist_ok=True)
    group = zarr.open_group(folder / "data", mode="w")
    for name, variable in VARIABLES.items():
        width = len(labels(plan)[variable.dim])
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
    write_whole(folder / "plan.json", plan.model_dump_json().encode())


def read_plan(folder: Path) -> str | None:
    """The plan of an unfinished dataset, as JSON; None where there is none."""
    file = folder / "plan.json"
    return file.read_text(encoding="utf-8") if file.is_file() else None


def fly_batch(plan: Plan, folder: Path, flights: Sequence[int]) -> Sequence[int]:
    """Simulate some flights of a plan and write each one; the work of one worker.

    Args:
        plan: The whole plan.
        folder: Its unfinished dataset, on a file system that every worker sees.
        flights: Numbers of the flights.

    Returns:
        The numbers of the flights, now whole.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is not seen by a worker: the workers must share a file system")
    seeds = [np.random.SeedSequence(plan.seed, spawn_key=(flight,)) for flight in flights]
    log = simulate_flights(plan.config, seeds, plan.steps, plan.rate_hz)
    for row, flight in enumerate(flights):
        values = {name: np.asarray(log[name][row], dtype="<f4") for name in VARIABLES}
        end_step, end_reason = int(log["end_step"][row]), str(log["end_reason"][row])
        write_flight(folder, flight, values, end_step, end_reason)
    return flights


def whole_flights(folder: Path) -> dict[int, Record]:
    """Flights that are complete, by number; one whose files have another size than recorded is not."""
    records = {}
    for file in sorted((folder / "flights").glob("[0-9]*.json")):
        flight = int(file.stem)
        try:
            record = Record(**json.loads(file.read_text(encoding="utf-8")))
            whole = record.stored_bytes == stored_bytes(folder / "data", flight)
        except (ValueError, TypeError, FileNotFoundError):
            continue  # cut short by a crash of the machine: the flight is simulated again
        if whole:
            records[flight] = record
    return records


def finish(folder: Path, plan: Plan | RecordedPlan, out: Path) -> None:
    """Add the coordinates, consolidate the metadata and move the store to its final place."""
    store = folder / "data"
    records = whole_flights(folder)
    _write_coordinates(store, plan, [records[flight] for flight in range(plan.flights)])
    for stray in store.glob(f"*/.*{PART}*"):  # a chunk that a killed worker left half written
        stray.unlink()
    others = {name: content_digest((store / name).read_bytes()) for name in _other_files()}
    digests = [records[flight].digest for flight in range(plan.flights)]
    write_json(store / DIGESTS, {"flights": digests, "others": others})
    if out.exists():
        out.rename(folder / "replaced")
    store.rename(out)
    shutil.rmtree(folder)


def read_attributes(path: Path) -> Attributes:
    """Attributes of a dataset.

    Raises:
        FileNotFoundError: There is nothing at the path.
        ValueError: Not a dataset, unfinished, or from a newer version.
    """
    folder = path if path.suffix == ".partial" else partial_folder(path)
    if folder.is_dir() and not path.joinpath("zarr.json").exists():
        plan = read_plan(folder)
        total = json.loads(plan)["flights"] if plan else "?"
        raise ValueError(
            f"{path} is unfinished: {len(whole_flights(folder))} of {total} flights; "
            "rerun the command that generates it to resume"
        )
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such dataset; `quadsim generate --out {path}` makes one")
    try:
        found = json.loads((path / "zarr.json").read_text(encoding="utf-8"))["attributes"]
        if found["format"] != FORMAT:
            raise ValueError(f"format {found['format']}")
        if found["format_version"] <= FORMAT_VERSION:
            return Attributes.model_validate(found)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{path} is not a dataset of quadsim; `quadsim generate` makes one") from error
    raise ValueError(
        f"{path} has format version {found['format_version']}, newer than the {FORMAT_VERSION} that this "
        "quadsim reads: update quadsim"
    )


def refuse_truncated(path: Path, attributes: Attributes) -> None:
    """Compare the files of a dataset with what was written.

    Raises:
        ValueError: A file is missing or has another size.
    """
    try:
        for name in ("flight", "time", *LABELS, *PER_FLIGHT):
            (path / name / "c" / "0").stat()
        written = np.asarray(zarr.open_array(path / "stored_bytes", mode="r")[:])
        for flight in range(attributes.flights):
            if stored_bytes(path, flight) != written[flight]:
                raise ValueError(
                    f"{path} is damaged: flight {flight} is cut short; copy or generate it again"
                )
    except FileNotFoundError as error:
        raise ValueError(
            f"{path} is truncated: {error.filename} is missing; copy or generate it again"
        ) from error


@contextmanager
def damage_in_words(path: Path) -> Iterator[None]:
    """Turn whatever a library says of a damaged dataset into one line that names it."""
    try:
        yield
    except Exception as error:
        if isinstance(error, ValueError | OSError) and str(path) in str(error):
            raise
        raise ValueError(
            f"{path} is damaged: {type(error).__name__}: {error}; copy or generate it again"
        ) from error


def refuse_damaged(path: Path, attributes: Attributes) -> None:
    """Compare shapes with the attributes, and every number with its checksum if a file has changed.

    Raises:
        ValueError: Something differs, or cannot be read.
    """
    refuse_mislabelled(path, attributes)
    files = sorted(file for file in path.rglob("*") if file.is_file())
    stamps = [(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    known = Path(user_cache_dir("quadsim")) / "verified" / fingerprint(str(path.absolute()), stamps)
    if known.exists():
        return
    for flight, found in faults(path):
        if found:
            raise ValueError(
                f"{path} is damaged: flight {flight}: {found}; quadsim report --verify lists all; copy or "
                "generate it again"
            )
    with suppress(OSError):  # without a cache it is verified again the next time
        write_whole(known, "")


def refuse_mislabelled(path: Path, attributes: Attributes) -> None:
    """Compare all but the numbers of flights with what quadsim writes, and with the files' digests.

    Raises:
        ValueError: The first that differs, what was found and what is expected.
    """
    root = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
    gathered = root["consolidated_metadata"]["metadata"]
    rotors = gathered["rotor"]["shape"][0]
    widths = {dim: rotors if dim == "rotor" else len(names) for dim, names in LABELS.items()}
    lengths = {"flight": attributes.flights, "time": attributes.steps, **widths}
    dims = {name: ["flight", "time", variable.dim] for name, variable in VARIABLES.items()}
    dims |= {name: [dim] for name, dim in COORDINATES.items()}
    for name, expected in dims.items():
        for found in (gathered[name], json.loads((path / name / "zarr.json").read_text(encoding="utf-8"))):
            unit, shape = found["attributes"].get("units"), [lengths[dim] for dim in expected]
            if unit != UNITS.get(name):
                raise ValueError(f"{path}: {name} is in {unit}, should be in {UNITS.get(name)}")
            if found["dimension_names"] != expected:
                dims_found = ", ".join(map(str, found["dimension_names"]))
                raise ValueError(f"{path}: {name} is over {dims_found}, should be over {', '.join(expected)}")
            if found["shape"] != shape:
                raise ValueError(
                    f"{path} is damaged: {name} has the shape {found['shape']}, should be {shape}"
                )
            if name in VARIABLES and found["data_type"] != "float32":
                raise ValueError(f"{path} is damaged: {name} is {found['data_type']}, should be float32")
    group = zarr.open_group(path, mode="r", zarr_format=3)
    valid, time = (np.asarray(_array(group, name)[:]) for name in ("valid_steps", "time"))
    if valid.dtype.kind not in "iu" or not ((valid >= 0) & (valid <= attributes.steps)).all():
        raise ValueError(f"{path} is damaged: valid_steps is not from 0 to {attributes.steps}")
    times = np.arange(attributes.steps) / attributes.rate_hz
    if not (
        time.shape == times.shape
        and np.allclose(time, times, rtol=1e-6, atol=1e-9)
        and np.isclose(attributes.duration_s, attributes.steps / attributes.rate_hz)
    ):
        raise ValueError(f"{path} is damaged: rate_hz, duration_s and time do not belong together")
    if not isinstance(json.loads(attributes.config), dict):
        raise ValueError(f"{path} is damaged: its configuration is no table")
    if changed := changed_files(path):
        raise ValueError(f"{path} is damaged: {', '.join(changed)} changed since it was written")


def changed_files(path: Path) -> list[str]:
    """Files, except the chunks of flights, that differ from their digests; none in an older dataset."""
    written = _digests(path).get("others", {})
    return [name for name, digest in written.items() if content_digest((path / name).read_bytes()) != digest]


def _digests(path: Path) -> dict[str, Any]:
    """Digests of the files of a dataset; empty in an older one."""
    try:
        return read_json(path / DIGESTS)
    except FileNotFoundError:
        return {}


def per_flight(path: Path, name: str) -> NDArray[np.generic]:
    """A coordinate of `PER_FLIGHT`, (flights,)."""
    return np.asarray(_array(zarr.open_group(path, mode="r", zarr_format=3), name)[:])


def read_chunk(path: Path, variable: str, flight: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """One variable of one flight, without Zarr's event loop, as in `write_flight`."""
    return np.frombuffer(CODEC.decode(chunk_file(path, variable, flight).read_bytes()), "<f4").reshape(shape)


def faults(path: Path) -> Iterator[tuple[int, str]]:
    """Read every flight of a dataset; its number, and the first thing wrong with it, empty if all is well."""
    group = zarr.open_group(path, mode="r", zarr_format=3)
    sizes, checksums = (np.asarray(_array(group, name)[:]) for name in ("stored_bytes", "checksum"))
    shapes = {name: _array(group, name).shape[1:] for name in VARIABLES}
    digests = _digests(path).get("flights")
    for flight, (size, stored) in enumerate(zip(sizes, checksums, strict=True)):
        found = fault(path, flight, shapes, int(size), str(stored))
        if not found and digests and chunks_digest(path, flight) != digests[flight]:
            found = "a file is not as it was written"
        yield flight, found


def fault(path: Path, flight: int, shapes: Mapping[str, tuple[int, ...]], size: int, stored: str) -> str:
    """The first thing wrong with a flight, given the shapes of its arrays, their stored size and checksum."""
    for name in VARIABLES:
        if not chunk_file(path, name, flight).exists():
            return f"{name} is missing"
    if stored_bytes(path, flight) != size:
        return "a file is cut short"
    try:
        values = {name: read_chunk(path, name, flight, shapes[name]) for name in VARIABLES}
    except Exception as error:  # whatever a codec says of what it cannot decode
        return f"it cannot be read: {error}"
    for name, array in values.items():
        if not np.isfinite(array).all():
            return f"{name} is not finite"
    return "" if checksum(values) == stored else "its checksum differs"


def checksum(values: Mapping[str, NDArray[np.float32]]) -> str:
    """SHA-256 over the numbers of one flight, little-endian, variable after variable."""
    digest = hashlib.sha256()
    for name in VARIABLES:
        digest.update(values[name].astype("<f4").tobytes())
    return digest.hexdigest()


def chunks_digest(store: Path, flight: int) -> str:
    """SHA-256 over the bytes of the chunks of a flight, variable after variable."""
    return content_digest(b"".join(chunk_file(store, name, flight).read_bytes() for name in VARIABLES))


def stored_bytes(store: Path, flight: int) -> int:
    """Size of the chunks of a flight on the disk; FileNotFoundError if one is missing."""
    return sum(chunk_file(store, name, flight).stat().st_size for name in VARIABLES)


def _array(group: zarr.Group, name: str) -> zarr.Array:
    found = group[name]
    if not isinstance(found, zarr.Array):
        raise ValueError(f"{name} is not an array")
    return found


def write_flight(
    folder: Path,
    flight: int,
    values: dict[str, NDArray[np.float32]],
    end_step: int,
    end_reason: str,
) -> None:
    """Write the chunks of a flight, and then the record that makes it whole."""
    valid_steps, end_reason = _hold_after_end(values, end_step, end_reason)
    numcodecs.blosc.use_threads = False  # several threads would order the blocks of a chunk by chance
    for name, array in values.items():  # as Zarr would, without its event loop: a tenth of the time
        write_whole(chunk_file(folder / "data", name, flight), CODEC.encode(array))
    store = folder / "data"
    size, digest = stored_bytes(store, flight), chunks_digest(store, flight)
    record = Record(valid_steps, end_reason, checksum(values), size, digest)
    write_whole(folder / "flights" / f"{flight:05d}.json", json.dumps(record._asdict()).encode())


def _hold_after_end(
    values: dict[str, NDArray[np.float32]], end_step: int, end_reason: str
) -> tuple[int, str]:
    """Repeat the last valid sample to the end of the array, in place; no file ever holds a NaN.

    A flight without any valid sample becomes all zeros, level.
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


def _write_coordinates(store: Path, plan: Plan | RecordedPlan, records: Sequence[Record]) -> None:
    group = zarr.open_group(store, mode="r+", zarr_format=3)
    attributes = Attributes(
        **plan.model_dump(exclude={"config"}),
        config=plan.config.model_dump_json(),
        duration_s=plan.steps / plan.rate_hz,
    )
    group.attrs.put(attributes.model_dump())

    def put(name: str, dim: str, values: NDArray[np.generic], **attributes: str) -> None:
        array = group.create_array(
            name,
            shape=values.shape,
            chunks=values.shape,
            dtype=str if values.dtype == object else values.dtype,
            dimension_names=(dim,),
            attributes={**attributes},
            config={"write_empty_chunks": True},
            overwrite=True,
        )
        array[:] = values

    def per_flight(field: str, **attributes: str) -> None:
        values = [getattr(record, field) for record in records]
        put(
            field,
            "flight",
            np.array(values, dtype=object if isinstance(values[0], str) else int),
            **attributes,
        )

    put("flight", "flight", np.arange(plan.flights), long_name="number of the flight")
    time = np.arange(plan.steps) / plan.rate_hz
    put("time", "time", time, units="s", long_name="time since the start of the flight")
    for dim, names in labels(plan).items():
        put(dim, dim, np.array(names, dtype=object), long_name="component")
    per_flight("valid_steps", long_name="valid samples; any later ones repeat the last of them")
    per_flight("end_reason", long_name="why the flight ended early; empty if it lasted its full time")
    per_flight("checksum", long_name="SHA-256 over the numbers of the flight, variable after variable")
    per_flight("stored_bytes", units="byte", long_name="size of the flight on the disk")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)  # says that other readers may ignore it
        zarr.consolidate_metadata(group.store)
