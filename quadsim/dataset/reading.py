"""Open, check and summarise a dataset."""

import json
from pathlib import Path

import numpy as np
import xarray as xr

from ..rotation import quat_rotate, roll_pitch_from_quat
from . import integrity
from .generation import Progress
from .store import PER_FLIGHT


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
    integrity.refuse_damaged(path)
    return dataset


def _labelled(path: Path) -> xr.Dataset:
    """A dataset whose files may be damaged; names, dimensions, shapes and units are right."""
    attributes = integrity.read_attributes(path)
    with integrity.damage_in_words(path):
        dataset = xr.open_dataset(path, engine="zarr", chunks=None, consolidated=True)
        integrity.refuse_mislabelled(path, dataset, attributes)
        dataset = dataset.set_coords(PER_FLIGHT)
        strings = [name for name, values in dataset.coords.items() if values.dtype.kind not in "if"]
        return dataset.assign_coords({name: dataset[name].astype(object) for name in strings})


def verify(path: str | Path, progress: Progress | None = None) -> int:
    """Compare every file of a dataset with its digest.

    Returns:
        How many flights were verified.

    Raises:
        ValueError: The damaged flights and the other files that are not as they were written; or what else is
            wrong, as on opening.
    """
    path = Path(path).expanduser()
    total = integrity.read_attributes(path).flights
    found = []
    with integrity.damage_in_words(path):
        for flight, fault in enumerate(integrity.flight_faults(path)):
            found += [fault] * bool(fault)
            if progress:
                progress(flight + 1, total)
        if found:
            raise ValueError(f"{path}: {len(found)} of {total} flights are damaged: {', '.join(found)}")
        _labelled(path)
        if changed := integrity.changed_files(path):
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
