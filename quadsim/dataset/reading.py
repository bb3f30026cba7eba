"""Open, check and summarise a dataset: its attributes, labels and units, and the digests of its files."""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import xarray as xr
from platformdirs import user_cache_dir

from ..rotation import quat_rotate, roll_pitch_from_quat
from ..runs.files import read_json, write_whole
from ..runs.fingerprint import fingerprint
from . import store
from .store import DIGESTS, FORMAT, FORMAT_VERSION, LABELS, PER_FLIGHT, VARIABLES, Attributes, Progress


def open_dataset(path: str | Path) -> xr.Dataset:
    """Open a dataset; its arrays are read when they are used.

    Opening always compares the names, dimensions, shapes and units of all arrays with those that quadsim
    writes. It compares every file with its digest the first time, and again when the size or the time stamp
    of a file has changed; `verify` always does.

    Args:
        path: A dataset that `generate` wrote.

    Returns:
        Variables over (flight, time, axis | quat_axis | rotor) in SI units, and coordinates per flight:
        `valid_steps` and `end_reason` tell how it went, and samples from `valid_steps` on repeat the last.

    Raises:
        FileNotFoundError: There is nothing at the path.
        ValueError: Not a dataset, unfinished, damaged, in other units or from a newer version.
    """
    path = Path(path).expanduser()
    dataset = _labelled(path)
    refuse_damaged(path)
    return dataset


def _labelled(path: Path) -> xr.Dataset:
    """A dataset whose files may be damaged; names, dimensions, shapes and units are right."""
    attributes = read_attributes(path)
    with damage_in_words(path):
        dataset = xr.open_dataset(path, engine="zarr", chunks=None, consolidated=True)
        refuse_mislabelled(path, dataset, attributes)
        dataset = dataset.set_coords(PER_FLIGHT)
        strings = [name for name, values in dataset.coords.items() if values.dtype.kind not in "if"]
        return dataset.assign_coords({name: dataset[name].astype(object) for name in strings})


def verify(path: str | Path, progress: Progress = lambda done, total: None) -> int:
    """Compare every file of a dataset with its digest.

    Returns:
        How many flights were verified.

    Raises:
        ValueError: The damaged flights and the other files that are not as they were written; or what else is
            wrong, as on opening.
    """
    path = Path(path).expanduser()
    total = read_attributes(path).flights
    found = []
    with damage_in_words(path):
        for flight, fault in enumerate(flight_faults(path)):
            found += [fault] * bool(fault)
            progress(flight + 1, total)
        if found:
            raise ValueError(f"{path}: {len(found)} of {total} flights are damaged: {', '.join(found)}")
        _labelled(path)
        if changed := changed_files(path):
            raise ValueError(f"{path} is damaged: {', '.join(changed)}")
    return total


def dataset_info(path: str | Path) -> dict[str, object]:
    """Summary of a dataset, over the samples before each flight's end; keys end in their unit.

    Returns:
        Size, rate, seed and configuration, and standard deviation of roll and of pitch
        over all samples, largest tilt, body rate and speed.

    Raises:
        ValueError: Not a dataset, or one without a single valid sample.
    """
    path = Path(path).expanduser()
    dataset = open_dataset(path)
    valid, end_reason = (dataset[name].to_numpy() for name in PER_FLIGHT)
    if not valid.any():
        raise ValueError(
            f"{path}: none of {valid.size} flights has a valid sample; the first: "
            f"{end_reason[0]}. Is a number of the configuration too large?"
        )
    tilt, rate, speed, angles = [], [], [], []
    for flight, steps in enumerate(valid.tolist()):
        one = dataset.isel(flight=flight, time=slice(steps))
        quat, ang_vel, velocity = (
            one[name].to_numpy().astype(float) for name in ("quat", "ang_vel", "velocity")
        )
        angles.append(roll_pitch_from_quat(quat))
        tilt.append(np.arccos(quat_rotate(quat, (0.0, 0.0, 1.0))[:, 2].clip(-1, 1)).max(initial=0))
        rate.append(np.linalg.norm(ang_vel, axis=-1).max(initial=0))
        speed.append(np.linalg.norm(velocity, axis=-1).max(initial=0))
    roll_sd, pitch_sd = np.std(np.concatenate(angles), axis=0)
    return {
        "path": str(path),
        "flights": valid.size,
        "flights_ended_early": int((end_reason != "").sum()),
        "duration_s": dataset.attrs["duration_s"],
        "rate_hz": dataset.attrs["rate_hz"],
        "samples": int(valid.sum()),
        "roll_sd_deg": float(np.degrees(roll_sd)),
        "pitch_sd_deg": float(np.degrees(pitch_sd)),
        "max_tilt_deg": float(np.degrees(max(tilt))),
        "max_rate_deg_s": float(np.degrees(max(rate))),
        "max_speed_m_s": float(max(speed)),
        "size_MB": sum(file.stat().st_size for file in path.glob("*/c.*")) / 1e6,
        "seed": dataset.attrs["seed"],
        "quadsim_version": dataset.attrs["quadsim_version"],
        "config": json.loads(dataset.attrs["config"]),
    }


def read_attributes(path: Path) -> Attributes:
    """Attributes of a dataset.

    Raises:
        FileNotFoundError: There is nothing at the path.
        ValueError: Not a dataset, unfinished, or from a newer version.
    """
    folder = path if path.suffix == ".partial" else store.partial_folder(path)
    if folder.is_dir() and not path.joinpath("zarr.json").exists():
        plan = store.read_plan(folder)
        total = json.loads(plan)["flights"] if plan else "?"
        raise ValueError(
            f"{path} is unfinished: {len(store.whole_flights(folder))} of {total} flights; "
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


@contextmanager
def damage_in_words(path: Path) -> Iterator[None]:
    """Turn whatever a library says of a damaged dataset into one line that names it."""
    try:
        yield
    except Exception as error:
        if isinstance(error, ValueError | PermissionError) and str(path) in str(error):
            raise
        raise ValueError(
            f"{path} is damaged: {type(error).__name__}: {error}; copy or generate it again"
        ) from error


def refuse_mislabelled(path: Path, dataset: xr.Dataset, attributes: Attributes) -> None:
    """Compare names, dimensions, shapes, types and units with what quadsim writes.

    Raises:
        ValueError: The first that differs, what was found and what is expected.
    """
    rotors = dataset.sizes["rotor"]
    lengths = {dim: rotors if dim == "rotor" else len(names) for dim, names in LABELS.items()}
    lengths |= {"flight": attributes.flights, "time": attributes.steps}
    expected = {dim: ((dim,), "s" if dim == "time" else None) for dim in lengths}
    expected |= {name: (("flight",), None) for name in PER_FLIGHT}
    expected |= {name: (("flight", "time", each.dim), each.units) for name, each in VARIABLES.items()}
    for name, (dims, units) in expected.items():
        found, shape = dataset[name], tuple(lengths[dim] for dim in dims)
        if found.attrs.get("units") != units:
            raise ValueError(f"{path}: {name} is in {found.attrs.get('units')}, should be in {units}")
        if found.dims != dims:
            raise ValueError(
                f"{path}: {name} is over {', '.join(map(str, found.dims))}, should be over {', '.join(dims)}"
            )
        if found.shape != shape:
            raise ValueError(f"{path} is damaged: {name} has the shape {found.shape}, should be {shape}")
        if name in VARIABLES and found.dtype != np.float32:
            raise ValueError(f"{path} is damaged: {name} is {found.dtype}, should be float32")


def refuse_damaged(path: Path) -> None:
    """Compare every file with its digest, unless none has changed in size or time stamp since the last time.

    Raises:
        ValueError: One differs, or is missing.
    """
    files = sorted(file for file in path.rglob("*") if file.is_file())
    stamps = [(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    known = Path(user_cache_dir("quadsim")) / "verified" / fingerprint(str(path.absolute()), stamps)
    if known.exists():
        return
    with damage_in_words(path):
        if faults := [*changed_files(path), *filter(None, flight_faults(path))]:
            hint = "quadsim report --verify lists all; copy or generate it again"
            raise ValueError(f"{path} is damaged: {faults[0]}; {hint}")
    with suppress(OSError):  # without a cache it is verified again the next time
        write_whole(known, "")


def changed_files(path: Path) -> list[str]:
    """What is wrong with files other than the chunks of flights."""
    written = read_json(path / DIGESTS)["others"]
    return [fault for name, digest in written.items() if (fault := _fault({name: path / name}, digest, name))]


def flight_faults(path: Path) -> Iterator[str]:
    """For each flight in turn what is wrong with it; empty if nothing is."""
    for flight, digest in enumerate(read_json(path / DIGESTS)["flights"]):
        fault = _fault({name: store.chunk_file(path, name, flight) for name in VARIABLES}, digest, "a file")
        yield f"flight {flight}: {fault}" if fault else ""


def _fault(files: dict[str, Path], digest: str, name: str) -> str:
    missing = [name for name, file in files.items() if not file.exists()]
    if missing:
        return f"{missing[0]} is missing"
    return "" if store.files_digest(files.values()) == digest else f"{name} changed since it was written"
