"""Open, check, summarise and split a dataset."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..rotation import quat_rotate, roll_pitch_from_quat
from . import store as dataset_store
from .generation import Progress, _at_least
from .store import Attributes, read_attributes

if TYPE_CHECKING:
    import xarray as xr


def open_dataset(path: str | Path) -> xr.Dataset:
    """Open a dataset; its arrays are read when they are used.

    Opening always compares the names, dimensions, shapes and units of all arrays with those that quadsim
    writes, and the configuration and coordinates with their digests. It compares every number with its
    checksum the first time, and again when the size or the time stamp of a file has changed. `verify`
    compares every file with its digest, whatever its time stamp.

    Args:
        path: A dataset that `generate` wrote.

    Returns:
        Variables over (flight, time, axis | quat_axis | rotor) in SI units, and coordinates per flight, of
        which `valid_steps` and `end_reason` tell how it went: samples from `valid_steps` on repeat the last.

    Raises:
        FileNotFoundError: There is nothing at the path.
        ValueError: Not a dataset, unfinished, damaged, in other units or from a newer version.
    """
    import xarray as xr  # takes half a second

    path = Path(path).expanduser()
    _checked_attributes(path)
    with dataset_store.damage_in_words(path):
        dataset = xr.open_dataset(path, engine="zarr", chunks=None, consolidated=True)
        dataset = dataset.set_coords(dataset_store.PER_FLIGHT)
        strings = [name for name, values in dataset.coords.items() if values.dtype.kind not in "if"]
        return dataset.assign_coords({name: dataset[name].astype(object) for name in strings})


def _checked_attributes(path: Path) -> Attributes:
    """Attributes of a dataset whose files are complete and as they were written."""
    attributes = read_attributes(path)
    with dataset_store.damage_in_words(path):
        dataset_store.refuse_truncated(path, attributes)
        dataset_store.refuse_damaged(path, attributes)
    return attributes


def verify(path: str | Path, progress: Progress | None = None) -> int:
    """Read every file of a dataset and compare it with its digest, and every number with its checksum.

    Older datasets have checksums of their numbers, but no digests of their files.

    Returns:
        How many flights were verified.

    Raises:
        ValueError: The damaged flights, each with the first thing wrong with it; or what else is wrong, as on
            opening; or the names of other files that are not as they were written.
    """
    path = Path(path).expanduser()
    attributes = read_attributes(path)
    total = attributes.flights
    damage = {}
    with dataset_store.damage_in_words(path):
        for flight, fault in dataset_store.faults(path):
            if fault:
                damage[flight] = fault
            if progress:
                progress(flight + 1, total)
    if damage:
        faults = ", ".join(f"flight {flight} ({fault})" for flight, fault in damage.items())
        raise ValueError(f"{path}: {len(damage)} of {total} flights are damaged: {faults}")
    with dataset_store.damage_in_words(path):
        dataset_store.refuse_mislabelled(path, attributes)
        if changed := dataset_store.changed_files(path):
            raise ValueError(f"{path} is damaged: not as they were written: {', '.join(changed)}")
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
    attributes = _checked_attributes(path)
    valid, end_reason, size = (
        dataset_store.per_flight(path, name) for name in ("valid_steps", "end_reason", "stored_bytes")
    )
    if not valid.any():
        raise ValueError(
            f"{path}: none of {attributes.flights} flights has a valid sample; the first: "
            f"{end_reason[0]}. Is a number of the configuration too large?"
        )
    tilt, rate, speed, angles = [], [], [], []
    for flight, steps in enumerate(valid.tolist()):
        quat, ang_vel, velocity = (
            dataset_store.read_chunk(path, name, flight, (attributes.steps, width))[:steps].astype(float)
            for name, width in (("quat", 4), ("ang_vel", 3), ("velocity", 3))
        )
        angles.append(roll_pitch_from_quat(quat))
        tilt.append(np.arccos(quat_rotate(quat, (0.0, 0.0, 1.0))[:, 2].clip(-1, 1)).max(initial=0))
        rate.append(np.linalg.norm(ang_vel, axis=-1).max(initial=0))
        speed.append(np.linalg.norm(velocity, axis=-1).max(initial=0))
    roll_sd, pitch_sd = np.std(np.concatenate(angles), axis=0)
    return {
        "path": str(path),
        "flights": attributes.flights,
        "flights_ended_early": int((end_reason != "").sum()),
        "duration_s": attributes.duration_s,
        "rate_hz": attributes.rate_hz,
        "samples": int(valid.sum()),
        "roll_sd_deg": float(np.degrees(roll_sd)),
        "pitch_sd_deg": float(np.degrees(pitch_sd)),
        "max_tilt_deg": float(np.degrees(max(tilt))),
        "max_rate_deg_s": float(np.degrees(max(rate))),
        "max_speed_m_s": float(max(speed)),
        "size_MB": float(size.sum()) / 1e6,
        "seed": attributes.seed,
        "quadsim_version": attributes.quadsim_version,
        "config": json.loads(attributes.config),
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
