"""Flights in time, small enough for a page: decimated, and packed into 16-bit integers."""

import base64
import zlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SERIES_HZ = 25.0
"""Samples per second of the time series that are stored for plots."""


@dataclass(frozen=True)
class Channel:
    """One quantity in time: 16-bit integers in base64, times a scale."""

    scale: float
    data: str


@dataclass(frozen=True)
class FlightSeries:
    """One flight in time: angles [deg], positions and set-points [m]."""

    dt: float
    """Time between two samples [s]."""
    channels: dict[str, Channel]

    @property
    def samples(self) -> int:
        """Length of every channel."""
        return len(_integers(self.channels["x"]))


def pack_series(log: NDArray[np.void], rate_hz: float) -> FlightSeries:
    """One flight's log (T,) of `flight_metrics.log_dtype`, decimated to `SERIES_HZ`."""
    every = max(round(rate_hz / SERIES_HZ), 1)
    shown = log[::every]
    angles = np.degrees(np.hstack([shown["euler"], shown["estimate"]]))
    names = ["roll", "pitch", "yaw", "roll_est", "pitch_est", "x", "y", "z", "x_ref", "y_ref", "z_ref"]
    columns = np.hstack([angles, shown["position"], shown["target"]])
    return FlightSeries(every / rate_hz, dict(zip(names, map(_pack, columns.T), strict=True)))


def unpack_series(series: FlightSeries) -> dict[str, Array]:
    """Every channel of a flight, each (T,), and its `time` [s]."""
    found = {
        name: channel.scale * _integers(channel).astype(np.float64)
        for name, channel in series.channels.items()
    }
    return found | {"time": series.dt * np.arange(len(found["x"]), dtype=np.float64)}


def compress_flights(flights: Iterable[FlightSeries]) -> str:
    """The integers of all channels of flights, one after the other, compressed without loss, in base64.

    Neighbours are close, so that differences (modulo 2^16) have few distinct bytes; all their low bytes come
    before all their high ones. The result is zlib's, RFC 1950, which browsers call "deflate".
    """
    parts = [_integers(channel) for flight in flights for channel in flight.channels.values()]
    steps = np.diff(np.concatenate([np.zeros(1, "<i2"), *parts]))
    return base64.b64encode(zlib.compress(steps.view(np.uint8).reshape(-1, 2).T.tobytes())).decode()


def _integers(channel: Channel) -> NDArray[np.int16]:
    return np.frombuffer(base64.b64decode(channel.data), "<i2")


def _pack(values: Array) -> Channel:
    scale = max(float(np.abs(values).max()), 1e-6) / 32767
    return Channel(scale, base64.b64encode(np.round(values / scale).astype("<i2").tobytes()).decode())
