"""The signals of a flight that identification needs, from a dataset or a log."""

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
"""Upper end of the frequency band that is used: above it, vibration and noise dominate."""
SETTLE_S = 0.5
"""Time that is left out at each end of a flight, where the low-pass has not settled."""
SHORTEST_S = 5.0
"""Shortest part without a missing sample that is used [s]."""


class Flight(NamedTuple):
    """Signals of one flight over T samples; an unknown signal is None."""

    rate_hz: float
    gyro: Array
    """Body rate (T, 3) [rad/s]."""
    accel: Array
    """Specific force (T, 3) [m/s²]."""
    rotor_vel: Array | None = None
    """Rotor speeds (T, rotors) [rad/s]."""
    rotor_vel_cmd: Array | None = None
    """Rotor commands between the previous sample and each sample (T, rotors) [rad/s]."""
    air_vel: Array | None = None
    """Velocity relative to the air, body axes (T, 3) [m/s]."""

    @property
    def has_rotors(self) -> bool:
        """Whether measured or commanded rotor speeds are known."""
        return self.rotor_vel is not None or self.rotor_vel_cmd is not None

    def part(self, start: int, end: int) -> Flight:
        """Return the samples from `start` up to but not including `end`."""
        return Flight(self.rate_hz, *(None if each is None else each[start:end] for each in self[1:]))  # pyright: ignore


def signals_of(data: xr.Dataset) -> list[Flight]:
    """Return the signals of each flight of a dataset or of a log from `read_log`.

    Only the longest part of a flight without a missing sample is used. The velocity is that of the data or,
    if there is none, the derivative of the position. A known wind is subtracted. The conversion to body axes
    needs an attitude. Signals that contain only zeros or NaN count as unknown.
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
    """Low-pass a signal (T, ·) without delay, and drop its ends."""
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
