"""Recorded flights as arrays for running and scoring estimators."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from quadsim.estimator import Readings
from quadsim.imu.spec import ImuSpec
from quadsim.rotation import roll_pitch_from_quat
from quadsim.vehicle import Vehicle

Array = NDArray[np.float64]
Initial = Literal["unknown", "known"]
"""Whether an estimator is given the initial attitude."""


@dataclass(frozen=True)
class Flights:
    """A batch of n flights with equal length and sample rate."""

    readings: Readings
    """Readings (n, T, ·)."""
    quat: Array
    """True quat_WB (n, T, 4)."""
    truth: Array
    """True roll and pitch (n, T, 2) [rad]; NaN is not scored."""
    rate_hz: float
    start: Array | None = None
    """Roll and pitch one sample before the first, (n, 2) [rad]; None if they are not known."""

    @property
    def gyro(self) -> Array:
        """Body rate (n, T, 3) [rad/s]."""
        return self.readings.gyro

    @property
    def accel(self) -> Array:
        """Specific force (n, T, 3) [m/s²]."""
        return self.readings.accel

    def map(self, change: Callable[[Array], Array], start: Array | None = None) -> "Flights":
        """Apply a function to readings and truth, and set another start."""
        return Flights(self.readings.map(change), change(self.quat), change(self.truth), self.rate_hz, start)

    def known(self) -> "Flights":
        """Return the flights from the second sample on, with a known start: the truth at the first sample."""
        return self.map(lambda each: np.ascontiguousarray(each[:, 1:]), self.truth[:, 0])

    def pieces(self, count: int) -> "Flights":
        """Cut every flight into `count` pieces of equal length. All pieces but the first begin in motion."""
        steps = self.gyro.shape[1] // count
        if steps < 1:
            raise ValueError(f"pieces: {count} of flights of {self.gyro.shape[1]} samples")
        return self.map(lambda each: each[:, : count * steps].reshape(-1, steps, each.shape[2]))


def load_flights(datasets: Sequence[xr.Dataset], count: int | None = None) -> Flights:
    """Load the first `count` flights of each dataset, or all, in double precision and with an unknown start.

    Raises:
        ValueError: A dataset has no flights, or datasets differ in length or sample rate.
    """
    parts = [_flights(dataset.isel(flight=slice(count))) for dataset in datasets]
    shapes = {(part.gyro.shape[1], part.rate_hz) for part in parts}
    if len(shapes) != 1:
        found = ", ".join(f"{steps} samples at {rate:g} Hz" for steps, rate in sorted(shapes))
        raise ValueError(f"datasets must agree in length and sample rate: {found}")
    sensors = {
        name: np.concatenate([getattr(part.readings, name) for part in parts])
        for name in Readings._fields
        if all(getattr(part.readings, name) is not None for part in parts)
    }
    quat, truth = (np.concatenate([getattr(part, name) for part in parts]) for name in ("quat", "truth"))
    return Flights(Readings(**sensors), quat, truth, parts[0].rate_hz)


def vehicle_of(dataset: xr.Dataset) -> Vehicle | None:
    """Return the airframe in the recipe of a dataset; None if it is not known."""
    config = _config(dataset)
    return Vehicle.model_validate(config["vehicle"]) if "vehicle" in config else None


def imu_of(dataset: xr.Dataset) -> ImuSpec | None:
    """Return the IMU in the recipe of a dataset; None if it is not known or the flights were recorded."""
    config = _config(dataset)
    return ImuSpec.model_validate(config["imu"]) if "vehicle" in config and "imu" in config else None


def _config(dataset: xr.Dataset) -> dict[str, Any]:
    return json.loads(dataset.attrs.get("config", "{}"))


def _flights(dataset: xr.Dataset) -> Flights:
    """Return all flights of a dataset; the truth is NaN after the end of a flight."""
    missing = [name for name in ("gyro", "accel", "quat") if name not in dataset]
    if "rate_hz" not in dataset.attrs:
        missing.append("rate_hz (an attribute)")
    if missing:
        raise ValueError(f"the dataset has no {', '.join(missing)}: not one of quadsim generate")
    unknown = _config(dataset).get("unknown", ())
    sensors = {
        name: np.ascontiguousarray(dataset[name].transpose("flight", "time", ...).values, np.float64)
        for name in ("quat", *Readings._fields)
        if name in dataset and name not in unknown
    }
    quat = sensors.pop("quat")
    truth = roll_pitch_from_quat(quat)
    if "valid_steps" in dataset:
        truth[np.arange(truth.shape[1]) >= dataset["valid_steps"].to_numpy()[:, None]] = np.nan
    return Flights(Readings(**sensors), quat, truth, float(dataset.attrs["rate_hz"]))
