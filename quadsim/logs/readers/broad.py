"""Trials of the BROAD benchmark (Laidig et al. 2021), as HDF5, MAT or NumPy npz files."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..recording import Array, Recording, Track

RATE_HZ = 2000.0 / 7.0
"""Sample rate of the benchmark, for files that do not give one."""


def read_broad(path: Path) -> Recording:
    """Read a trial: IMU and magnetometer in FLU axes, optical attitude (z up), and the samples to score."""
    content = {".hdf5": _hdf5, ".h5": _hdf5, ".mat": _mat, ".npz": _npz}[path.suffix.lower()](path)
    names = {"gyro": "imu_gyr", "acc": "imu_acc", "quat": "opt_quat"}
    found = {new: content.get(old, content.get(new)) for new, old in names.items()}
    stamped = found["quat"] is not None or "t" in content
    if found["gyro"] is None or found["acc"] is None or not stamped:
        raise ValueError(f"{path}: not a BROAD trial; it holds {', '.join(sorted(content))}")
    gyro, acc = (_rows(found[name], 3) for name in ("gyro", "acc"))
    steps = len(gyro)
    rate = float(np.ravel(content.get("sampling_rate", RATE_HZ))[0])
    time = np.asarray(content.get("t", np.arange(steps) / rate), np.float64).ravel()
    if found["quat"] is None:
        return Recording(path.stem, "IMU's arrays", time, gyro, acc)
    valid = np.asarray(content.get("valid", np.ones(steps)), bool).ravel()
    trial = "opt_quat" in content
    field = {"mag": Track(time, _rows(content["imu_mag"], 3) * 1e-6)} if "imu_mag" in content else {}
    return Recording(
        path.stem, "BROAD trial" if trial else "IMU's arrays", time, gyro, acc,
        truth="opt_quat: OptiTrack" if trial else "quat", truth_time=time, truth_axes="imu",
        quat=np.where(valid[:, None], _rows(found["quat"], 4), np.nan),
        marked=np.asarray(content.get("movement", np.ones(steps)), bool).ravel(),
        notes=("hand-moved, not flown",) if trial else (), sensors=field,
    )  # fmt: skip


def _rows(values: ArrayLike | None, width: int) -> Array:
    array = np.asarray(values, np.float64)
    return np.ascontiguousarray(array.T if array.shape[0] == width != array.shape[-1] else array)


def _hdf5(path: Path) -> Mapping[str, Any]:
    import h5py

    with h5py.File(path) as file:
        arrays = {str(name): each[()] for name, each in file.items() if isinstance(each, h5py.Dataset)}
        return dict(file.attrs) | arrays


def _mat(path: Path) -> Mapping[str, ArrayLike]:
    from scipy.io import loadmat

    try:
        return loadmat(path, squeeze_me=True)
    except NotImplementedError:  # version 7.3 is HDF5
        return _hdf5(path)


def _npz(path: Path) -> Mapping[str, ArrayLike]:
    if not zipfile.is_zipfile(path):
        raise ValueError(f"{path}: not a whole npz file")
    with np.load(path) as file:
        return {name: file[name] for name in file.files}
