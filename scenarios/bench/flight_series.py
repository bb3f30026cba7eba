"""Time series of flights for reports, decimated and packed into 16-bit integers."""

import base64
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SERIES_HZ = 25.0
"""Samples per second of the stored time series."""
MISSING = -32768
"""Integer that represents a missing number."""
LEVELS, SIGNAL_LEVELS = 32767, 1023
"""Number of integers on either side of zero, for channels and for signals, which need less resolution."""
ANGLE_STEP, LENGTH_STEP = 0.002, 0.0005
"""Smallest steps of angles [deg] and positions [m]."""
ANGLES = ("roll", "pitch", "yaw", "roll_est", "pitch_est")
CHANNELS = (*ANGLES, "x", "y", "z", "x_ref", "y_ref", "z_ref")
"""Angles [deg], positions and set-points [m]."""


@dataclass(frozen=True)
class Channel:
    """A time series: 16-bit integers in base64, and a scale."""

    scale: float
    data: str


@dataclass(frozen=True)
class FlightSeries:
    """Time series of a flight."""

    dt: float
    """Sample period [s]."""
    channels: dict[str, Channel]
    """Time series of `CHANNELS`, and signals of `flight_log.Flown` that have a value."""

    @property
    def samples(self) -> int:
        """Number of samples in every channel."""
        return len(_integers(next(iter(self.channels.values()))))

    def only(self, wanted: Callable[[str], bool]) -> "FlightSeries":
        """Return the time series of some channels."""
        return FlightSeries(self.dt, {name: each for name, each in self.channels.items() if wanted(name)})


def decimation(rate_hz: float) -> int:
    """Return the decimation factor of a series."""
    return max(round(rate_hz / SERIES_HZ), 1)


def pack_series(log: NDArray[np.void], rate_hz: float, signals: Mapping[str, Array]) -> FlightSeries:
    """Pack the log (T,) of a flight, of type `flight_log.log_dtype`, decimated to `SERIES_HZ`.

    Args:
        log: The flight, until its end.
        rate_hz: Samples per second of the log.
        signals: Further channels by name, already decimated and at least as long; NaN where missing.
    """
    every = decimation(rate_hz)
    shown = log[::every]
    angles = np.degrees(np.hstack([shown["euler"], shown["estimate"]]))
    columns = zip(CHANNELS, np.hstack([angles, shown["position"], shown["target"]]).T, strict=True)
    channels = {n: pack_channel(v, LEVELS, ANGLE_STEP if n in ANGLES else LENGTH_STEP) for n, v in columns}
    known = {name: v[: len(shown)] for name, v in signals.items() if not np.isnan(v[: len(shown)]).all()}
    channels |= {name: pack_channel(v, SIGNAL_LEVELS) for name, v in known.items()}
    return FlightSeries(every / rate_hz, channels)


def compress_flights(flights: Iterable[FlightSeries]) -> str:
    """Compress the integers of all channels of flights without loss, in base64.

    The differences (modulo 2^16) of neighbouring integers have few distinct bytes. All low bytes come before
    all high bytes. The format is zlib's, RFC 1950, which browsers call "deflate".
    """
    parts = [_integers(channel) for flight in flights for channel in flight.channels.values()]
    steps = np.diff(np.concatenate([np.zeros(1, "<i2"), *parts]))
    return base64.b64encode(zlib.compress(steps.view(np.uint8).reshape(-1, 2).T.tobytes())).decode()


def _integers(channel: Channel) -> NDArray[np.int16]:
    return np.frombuffer(base64.b64decode(channel.data), "<i2")


def pack_channel(values: Array, levels: int = LEVELS, step: float = 1e-9) -> Channel:
    """Pack a time series (T,), NaN where missing, as integers up to ±`levels` in multiples of a `step`."""
    finite = np.isfinite(values)
    scale = max(step, np.abs(values[finite]).max(initial=0.0) / levels)
    scale = float(f"{scale:.6g}")  # short in the page
    integers = np.where(finite, np.round(np.where(finite, values, 0.0) / scale), MISSING).astype("<i2")
    return Channel(scale, base64.b64encode(integers.tobytes()).decode())
