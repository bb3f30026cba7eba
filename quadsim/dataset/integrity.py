"""Whether a dataset is whole: its attributes, its labels and units, and the digests of its files."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path

import numpy as np
import xarray as xr
from platformdirs import user_cache_dir

from ..runs.files import read_json, write_whole
from ..runs.fingerprint import fingerprint
from .store import (
    DIGESTS,
    FORMAT,
    FORMAT_VERSION,
    LABELS,
    PER_FLIGHT,
    VARIABLES,
    Attributes,
    chunk_file,
    files_digest,
    partial_folder,
    read_plan,
    whole_flights,
)


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
        if fault := next(chain(changed_files(path), filter(None, flight_faults(path))), ""):
            raise ValueError(
                f"{path} is damaged: {fault}; quadsim report --verify lists all; copy or generate it again"
            )
    with suppress(OSError):  # without a cache it is verified again the next time
        write_whole(known, "")


def changed_files(path: Path) -> list[str]:
    """What is wrong with files other than the chunks of flights."""
    written = read_json(path / DIGESTS)["others"]
    return [fault for name, digest in written.items() if (fault := _fault({name: path / name}, digest))]


def flight_faults(path: Path) -> Iterator[str]:
    """For each flight in turn what is wrong with it; empty if nothing is."""
    for flight, digest in enumerate(read_json(path / DIGESTS)["flights"]):
        fault = _fault({name: chunk_file(path, name, flight) for name in VARIABLES}, digest)
        yield f"flight {flight}: {fault}" if fault else ""


def _fault(files: Mapping[str, Path], digest: str) -> str:
    missing = [name for name, file in files.items() if not file.exists()]
    if missing:
        return f"{missing[0]} is missing"
    changed = files_digest(files.values()) != digest
    return (
        f"{next(iter(files)) if len(files) == 1 else 'a file'} changed since it was written"
        if changed
        else ""
    )
