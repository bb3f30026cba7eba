"""Recorded flights as the arrays that estimators are run on and scored against."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from quadsim.imu.spec import ImuSpec
from quadsim.rotation import roll_pitch_from_quat
from quadsim.vehicle import Vehicle

Array = NDArray[np.float64]
Initial = Literal["unknown", "known"]
"""Whether an estimator is told the attitude that it starts at."""


@dataclass(frozen=True)
class Flights:
    """n flights of one length and sample rate."""

    gyro: Array
    """(n, T, 3) [rad/s]."""
    accel: Array
    """(n, T, 3) [m/s²]."""
    quat: Array
    """True quat_WB (n, T, 4)."""
    truth: Array
    """True roll and pitch (n, T, 2) [rad]; what is NaN is not scored."""
    rate_hz: float
    start: Array | None = None
    """Roll and pitch one sample before the first, (n, 2) [rad], or None where it is not known."""

    def known(self) -> "Flights":
        """The flights from the second sample on, started at the true attitude of the first."""
        gyro, accel, quat, truth = (
            np.ascontiguousarray(each[:, 1:]) for each in (self.gyro, self.accel, self.quat, self.truth)
        )
        return Flights(gyro, accel, quat, truth, self.rate_hz, self.truth[:, 0])

    def first(self, count: int) -> "Flights":
        """The first `count` flights."""
        gyro, accel, quat, truth = (each[:count] for each in (self.gyro, self.accel, self.quat, self.truth))
        start = None if self.start is None else self.start[:count]
        return Flights(gyro, accel, quat, truth, self.rate_hz, start)

    def pieces(self, count: int) -> "Flights":
        """Every flight cut into `count` pieces of one length, started anew: all but the first in motion."""
        steps = self.gyro.shape[1] // count
        if steps < 1:
            raise ValueError(f"pieces: {count} of flights of {self.gyro.shape[1]} samples")
        gyro, accel, quat, truth = (
            each[:, : count * steps].reshape(-1, steps, each.shape[2])
            for each in (self.gyro, self.accel, self.quat, self.truth)
        )
        return Flights(gyro, accel, quat, truth, self.rate_hz)


def load_flights(datasets: Sequence[xr.Dataset], count: int | None = None) -> Flights:
    """The first `count` flights of each dataset, or all, in double precision and with an unknown start.

    Raises:
        ValueError: If a dataset is not one of flights, or they differ in length or sample rate.
    """
    parts = [_arrays(dataset.isel(flight=slice(count))) for dataset in datasets]
    shapes = {(part[0].shape[1], part[3]) for part in parts}
    if len(shapes) != 1:
        found = ", ".join(f"{steps} samples at {rate:g} Hz" for steps, rate in sorted(shapes))
        raise ValueError(f"datasets must agree in length and sample rate: {found}")
    gyro, accel, quat = (np.concatenate([part[k] for part in parts]) for k in range(3))
    truth = roll_pitch_from_quat(quat)
    truth[~np.concatenate([part[4] for part in parts])] = np.nan
    return Flights(gyro, accel, quat, truth, parts[0][3])


def vehicle_of(dataset: xr.Dataset) -> Vehicle | None:
    """The airframe that flew a dataset, as its recipe has it; None where the dataset does not say."""
    config = json.loads(dataset.attrs.get("config", "{}"))
    return Vehicle.model_validate(config["vehicle"]) if "vehicle" in config else None


def imu_of(dataset: xr.Dataset) -> ImuSpec | None:
    """The IMU of a dataset; None where the dataset does not say, or it was recorded."""
    config = json.loads(dataset.attrs.get("config", "{}"))
    return ImuSpec.model_validate(config["imu"]) if "vehicle" in config and "imu" in config else None


def _arrays(dataset: xr.Dataset) -> tuple[Array, Array, Array, float, NDArray[np.bool_]]:
    """Gyro, accel, quat, rate_hz, and which samples (n, T) were flown before the flight ended."""
    missing = [name for name in ("gyro", "accel", "quat") if name not in dataset]
    if "rate_hz" not in dataset.attrs:
        missing.append("rate_hz (an attribute)")
    if missing:
        raise ValueError(f"the dataset has no {', '.join(missing)}: not one of quadsim generate")
    gyro, accel, quat = (
        np.ascontiguousarray(dataset[name].transpose("flight", "time", ...).values, np.float64)
        for name in ("gyro", "accel", "quat")
    )
    flown = np.ones(gyro.shape[:2], np.bool_)
    if "valid_steps" in dataset:
        flown = np.arange(gyro.shape[1]) < dataset["valid_steps"].to_numpy()[:, None]
    return gyro, accel, quat, float(dataset.attrs["rate_hz"]), flown
