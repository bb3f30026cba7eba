"""What an IMU adds in flight: noise and the vibration of the rotors, from the spectrum of its readings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt, welch

from .signals import Flight

Array = NDArray[np.float64]

ABOVE_HZ = 25.0
"""Below it the vehicle itself moves."""
SEGMENT_S = 2.0
"""Length of the segments whose spectra are averaged [s]."""
STILL_GYRO, STILL_ACCEL = 0.03, 0.3
"""Standard deviation of a second's readings at rest, at most [rad/s], [m/s²]."""
REST_S = 3
"""Fewest seconds of rest whose spectrum is shown."""


class InFlight(NamedTuple):
    """Of one sensor, its three axes together where one number stands for them."""

    frequency: Array
    """(F,) [Hz]."""
    density: Array
    """Power spectral density of each axis, one-sided (F, 3) [unit²/Hz]."""
    shaking: Array
    """Root mean square above 25 Hz (3,) [unit]."""
    noise: Array
    """Density of what is even, the median above 25 Hz, as IMU files give it: two-sided (3,) [unit/√Hz]."""
    line_hz: float
    """Frequency of the largest line; NaN where none stands out."""
    line: Array
    """Amplitude of that line (3,) [unit]."""


def noise_in_flight(signal: Array, rate_hz: float) -> InFlight:
    """Noise and vibration of readings.

    Args:
        signal: Gyroscope or accelerometer (T, 3), nothing missing.
        rate_hz: Samples per second, above 100.
    """
    frequency, density = welch(signal, rate_hz, nperseg=round(SEGMENT_S * rate_hz), axis=0)
    above = frequency > ABOVE_HZ
    shaking = sosfiltfilt(butter(4, ABOVE_HZ, "highpass", fs=rate_hz, output="sos"), signal, axis=0).std(
        axis=0
    )
    level = np.median(density[above], axis=0)
    total = density.sum(axis=1)
    peak = int(np.flatnonzero(above)[np.argmax(total[above])])
    near = slice(max(peak - 3, 0), peak + 4)
    stands_out = total[peak] > 20.0 * level.sum()
    power = np.maximum(density[near] - level, 0.0).sum(axis=0) * (frequency[1] - frequency[0])
    return InFlight(
        frequency,
        density,
        shaking,
        np.sqrt(0.5 * level),
        float(frequency[peak]) if stands_out else float("nan"),
        np.sqrt(2.0 * power) if stands_out else np.full(3, np.nan),
    )


def in_the_air(flight: Flight) -> Flight:
    """The part in which the vehicle flies; all of it where it never rests."""
    busy = np.flatnonzero(~_still(flight))
    return _part(flight, int(busy[0]), int(busy[-1]) + 1) if len(busy) else flight


def at_rest(flight: Flight) -> Flight | None:
    """The longest part of 3 s and more in which it rests, or None."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], _still(flight).astype(np.int8), [0]]))).reshape(-1, 2)
    start, end = max(edges.tolist(), key=lambda run: run[1] - run[0], default=(0, 0))
    return _part(flight, start, end) if end - start >= REST_S else None


def _still(flight: Flight) -> NDArray[np.bool_]:
    """Whether each second rests: its readings shake no more than a sensor's own noise."""
    second = round(flight.rate_hz)
    count = len(flight.accel) // second
    gyro, accel = (
        values[: count * second].reshape(count, second, 3).std(axis=1).max(axis=1)
        for values in (flight.gyro, flight.accel)
    )
    return (gyro < STILL_GYRO) & (accel < STILL_ACCEL)


def _part(flight: Flight, start_s: int, end_s: int) -> Flight:
    return flight.part(slice(round(start_s * flight.rate_hz), round(end_s * flight.rate_hz)))
