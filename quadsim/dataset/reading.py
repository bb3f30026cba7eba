"""Open, check and summarise a dataset."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from platformdirs import user_cache_dir

from ..rotation import quat_rotate, roll_pitch_from_quat
from ..runs.files import read_json, write_whole
from ..runs.fingerprint import fingerprint
from . import store
from .store import DIGESTS, FORMAT, FORMAT_VERSION, PER_FLIGHT, VARIABLES, Progress


def open_dataset(path: str | Path) -> xr.Dataset:
    """Open a dataset. Arrays are read from disk on first use.

    Every file is compared with its checksum the first time, and again if the size or the time stamp of a file
    has changed. `verify` always compares every file.

    Args:
        path: A dataset written by `generate`.

    Returns:
        Variables over (flight, time, axis | quat_axis | rotor) in SI units. The coordinates `valid_steps` and
        `end_reason` give the number of valid samples of each flight and why it ended early. Samples from
        `valid_steps` on repeat the last valid sample.

    Raises:
        FileNotFoundError: There is nothing at the path.
        ValueError: The path is not a dataset, or the dataset is incomplete, damaged, edited or from a newer
            version.
    """
    path = Path(path).expanduser()
    read_attributes(path)
    refuse_damaged(path)
    dataset = xr.open_dataset(path, engine="zarr", chunks=None, consolidated=True).set_coords(PER_FLIGHT)
    strings = [name for name, values in dataset.coords.items() if values.dtype.kind not in "if"]
    return dataset.assign_coords({name: dataset[name].astype(object) for name in strings})


def verify(path: str | Path, progress: Progress = lambda done, total: None) -> int:
    """Compare every file of a dataset with its checksum.

    Returns:
        Number of verified flights.

    Raises:
        ValueError: Files differ from their checksums, in which case the message names the damaged flights and
            files; or the path is not a dataset, or the dataset is incomplete or from a newer version.
    """
    path = Path(path).expanduser()
    total = read_attributes(path)["flights"]
    found = []
    try:
        written = read_json(path / DIGESTS)
        for flight, digest in enumerate(written["flights"]):
            chunks = {name: store.chunk_file(path, name, flight) for name in VARIABLES}
            if fault := _fault(chunks, digest, "a file"):
                found.append(f"flight {flight}: {fault}")
            progress(flight + 1, total)
        others = [_fault({name: path / name}, digest, name) for name, digest in written["others"].items()]
        found += filter(None, others)
    except FileNotFoundError as error:
        found = [str(error)]
    if found:
        more = f" and {len(found) - 9} more" if len(found) > 9 else ""
        raise ValueError(f"{path} is damaged: {', '.join(found[:9])}{more}; copy or generate it again")
    return total


def _fault(files: dict[str, Path], digest: str, name: str) -> str:
    """Return a description of the damage to files with one common checksum; empty if they are intact."""
    missing = [name for name, file in files.items() if not file.exists()]
    if missing:
        return f"{missing[0]} is missing"
    return "" if store.files_digest(files.values()) == digest else f"{name} changed since it was written"


def refuse_damaged(path: Path) -> None:
    """Verify a dataset if the size or the time stamp of a file has changed since the last verification.

    Raises:
        ValueError: A file is missing or differs from its checksum.
    """
    files = sorted(file for file in path.rglob("*") if file.is_file())
    stamps = [(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    known = Path(user_cache_dir("quadsim")) / "verified" / fingerprint(str(path.absolute()), stamps)
    if not known.exists():
        verify(path)
        with suppress(OSError):  # without a cache it is verified again the next time
            write_whole(known, "")


def dataset_info(path: str | Path) -> dict[str, object]:
    """Summarise the valid samples of a dataset; keys end in their unit.

    Returns:
        Size, rate, seed and configuration; standard deviation of roll and of pitch; largest tilt, body rate
        and speed.

    Raises:
        ValueError: The path is not a dataset, or the dataset has no valid sample.
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


def read_attributes(path: Path) -> dict[str, Any]:
    """Return the attributes of a dataset without verifying its files.

    Raises:
        FileNotFoundError: There is nothing at the path.
        ValueError: The path is not a dataset, or the dataset is incomplete or from a newer version.
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
        newer = found["format_version"] > FORMAT_VERSION
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{path} is not a dataset of quadsim; `quadsim generate` makes one") from error
    if newer:
        raise ValueError(
            f"{path} has format version {found['format_version']}, newer than the {FORMAT_VERSION} that this "
            "quadsim reads: update quadsim"
        )
    return found
