"""What identification needs of a flight, from a dataset or a log."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

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
    rotor_vel: Array | None
    """(T, rotors) [rad/s]."""
    rotor_vel_cmd: Array | None
    """Commanded up to each sample, from the one before (T, rotors) [rad/s]."""
    air_vel: Array | None
    """Velocity against the air, body axes (T, 3) [m/s]."""

    @property
    def has_rotors(self) -> bool:
        """Whether rotor speeds are known, measured or commanded."""
        return self.rotor_vel is not None or self.rotor_vel_cmd is not None

    def part(self, cut: slice) -> Flight:
        """Some of its samples."""
        kept = {
            name: None if x is None else x[cut] for name, x in self._asdict().items() if name != "rate_hz"
        }
        return self._replace(**kept)


def flights_of(data: xr.Dataset) -> list[Flight]:
    """Signals of each flight of a dataset or of a log, as `read_log` returns it.

    Of each, the longest part in which no sample is missing. Velocity is that of the data, else the derivative
    of the position, less the wind where the data know it; it needs an attitude.
    """
    found = []
    for k in range(data.sizes["flight"]):
        one = data.isel(flight=k)
        steps = int(one["valid_steps"])
        held = {str(name): one[name].to_numpy().astype(float)[:steps] for name in one.data_vars}
        flight = Flight(
            float(data.attrs["rate_hz"]),
            held["gyro"],
            held["accel"],
            held.get("rotor_vel"),
            held.get("rotor_vel_cmd"),
            _air_velocity(held, float(data.attrs["rate_hz"])),
        )
        found += _whole(_without_unknown(flight))
    return found


def low_passed(signal: Array, rate_hz: float, band_hz: float = BAND_HZ) -> Array:
    """Without what is above the band, and without delay; (T, ·)."""
    return sosfiltfilt(butter(4, band_hz, fs=rate_hz, output="sos"), signal, axis=0)


def settled(signal: Array, rate_hz: float) -> Array:
    """Without the ends, where the low-pass has not settled."""
    cut = round(SETTLE_S * rate_hz)
    return signal[cut : len(signal) - cut]


def _air_velocity(held: dict[str, Array], rate_hz: float) -> Array | None:
    if "quat" not in held or not np.isfinite(held["quat"]).any():
        return None
    if "velocity" in held:
        velocity = held["velocity"]
    elif "position" in held and np.isfinite(held["position"]).all():
        velocity = np.gradient(low_passed(held["position"], rate_hz), 1.0 / rate_hz, axis=0)
    else:
        return None
    return quat_rotate_inverse(held["quat"], velocity - held.get("wind", np.zeros(3)))


def _without_unknown(flight: Flight) -> Flight:
    """Signals that the data hold as zeros or NaN alone are not known."""
    return flight._replace(
        **{
            name: None
            for name in ("rotor_vel", "rotor_vel_cmd", "air_vel")
            if (values := getattr(flight, name)) is not None and not np.nan_to_num(values).any()
        }
    )


def _whole(flight: Flight) -> Iterable[Flight]:
    """The longest part in which nothing is missing; none that is too short."""
    arrays = [values for values in flight[1:] if values is not None]
    good = np.logical_and.reduce([np.isfinite(values).all(axis=1) for values in arrays])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]]))).reshape(-1, 2)
    start, end = max(edges.tolist(), key=lambda run: run[1] - run[0], default=(0, 0))
    if end - start >= SHORTEST_S * flight.rate_hz:
        yield flight.part(slice(start, end))
