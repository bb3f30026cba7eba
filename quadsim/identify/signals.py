"""What identification needs of a flight, from a dataset or a log."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from ..dataset.stretches import longest_stretch
from ..rotation import quat_rotate_inverse

Array = NDArray[np.float64]

BAND_HZ = 12.0
"""Above it vibration and noise outweigh what the vehicle does."""
SETTLE_S = 0.5
"""Left out at each end of a flight, where the low-pass has not settled."""
SHORTEST_S = 5.0
"""Fewest seconds without a missing sample that are used."""


class Flight(NamedTuple):
    """Signals of one flight over T samples; None where they are not known."""

    rate_hz: float
    gyro: Array
    """(T, 3) [rad/s]."""
    accel: Array
    """Specific force (T, 3) [m/s²]."""
    rotor_vel: Array | None = None
    """(T, rotors) [rad/s]."""
    rotor_vel_cmd: Array | None = None
    """Commanded up to each sample, from the one before (T, rotors) [rad/s]."""
    air_vel: Array | None = None
    """Velocity against the air, body axes (T, 3) [m/s]."""

    @property
    def has_rotors(self) -> bool:
        """Whether rotor speeds are known, measured or commanded."""
        return self.rotor_vel is not None or self.rotor_vel_cmd is not None

    def part(self, start: int, end: int) -> Flight:
        """The samples from `start` until before `end`."""
        return Flight(self.rate_hz, *(None if each is None else each[start:end] for each in self[1:]))  # pyright: ignore


def flights_of(data: xr.Dataset) -> list[Flight]:
    """Signals of each flight of a dataset or of a log, as `read_log` returns it.

    Of each, the longest part in which no sample is missing. Velocity is that of the data, else the derivative
    of the position, less the wind where the data know it; it needs an attitude. Signals that the data hold as
    zeros or NaN alone are not known.
    """
    found, rate_hz = [], float(data.attrs["rate_hz"])
    for k in range(data.sizes["flight"]):
        one = data.isel(flight=k, time=slice(int(data["valid_steps"][k])))
        held = {str(name): one[name].to_numpy().astype(float) for name in one.data_vars}
        others = (held.get("rotor_vel"), held.get("rotor_vel_cmd"), _air_velocity(held, rate_hz))
        known = [each if each is not None and np.nan_to_num(each).any() else None for each in others]
        flight = Flight(rate_hz, held["gyro"], held["accel"], *known)
        arrays = [each for each in flight[1:] if each is not None]
        start, end = longest_stretch(np.isfinite(np.concatenate(arrays, axis=1)).all(axis=1))
        if end - start >= SHORTEST_S * rate_hz:
            found.append(flight.part(start, end))
    return found


def below_band(signal: Array, rate_hz: float) -> Array:
    """A signal (T, ·) without what is above the band, without delay, and without the ends."""
    cut = round(SETTLE_S * rate_hz)
    return _low_passed(signal, rate_hz)[cut : len(signal) - cut]


def _low_passed(signal: Array, rate_hz: float) -> Array:
    return sosfiltfilt(butter(4, BAND_HZ, fs=rate_hz, output="sos"), signal, axis=0)


def _air_velocity(held: dict[str, Array], rate_hz: float) -> Array | None:
    if "quat" not in held or not np.isfinite(held["quat"]).any():
        return None
    if "velocity" in held:
        velocity = held["velocity"]
    elif "position" in held and np.isfinite(held["position"]).all():
        velocity = np.gradient(_low_passed(held["position"], rate_hz), 1.0 / rate_hz, axis=0)
    else:
        return None
    return quat_rotate_inverse(held["quat"], velocity - held.get("wind", np.zeros(3)))
