"""What an IMU adds in flight: noise and the vibration of the rotors, from the spectrum of its readings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import butter, sosfiltfilt, welch

from ..dataset.stretches import blocks_of, longest_stretch
from .signals import Flight

Array = NDArray[np.float64]

ABOVE_HZ = 25.0
"""Below it the vehicle itself moves."""
FLYING, RESTING = (25.0, 60.0), (1.0, 20.0)
"""Bands in which the density is taken [Hz]: below the low-pass of most sensors."""
AROUND_HZ, STANDS_OUT = 90.0, 5.0
"""A line has so many times the median density of the frequencies around it."""
SEGMENT_S = 2.0
"""Length of the segments whose spectra are averaged [s]."""
STILL_GYRO, STILL_ACCEL = 0.03, 0.3
"""Standard deviation of a second's readings at rest, at most [rad/s], [m/s²]."""
REST_S = 3
"""Fewest seconds of rest whose spectrum is shown."""


class Spectrum(NamedTuple):
    """Noise and vibration of the three axes of one sensor."""

    frequency: Array
    """(F,) [Hz]."""
    density: Array
    """Power spectral density of each axis, one-sided (F, 3) [unit²/Hz]."""
    shaking: Array
    """Root mean square above 25 Hz (3,) [unit]."""
    noise: Array
    """Median density in the band, as IMU files give it: two-sided (3,) [unit/√Hz]."""
    line_hz: float
    """Frequency of the line that stands out most from what is around it; NaN where none does."""
    line: Array
    """Amplitude of that line (3,) [unit]."""


def spectrum(signal: Array, rate_hz: float, band: tuple[float, float] = FLYING) -> Spectrum:
    """Noise and vibration of readings.

    Args:
        signal: Gyroscope or accelerometer (T, 3), nothing missing.
        rate_hz: Samples per second, above 100.
        band: Where the density of the noise is taken [Hz]: `FLYING` or `RESTING`.
    """
    frequency, density = welch(signal, rate_hz, nperseg=round(SEGMENT_S * rate_hz), axis=0)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    highpass = butter(4, ABOVE_HZ, "highpass", fs=rate_hz, output="sos")
    total, step = density.sum(axis=1), float(frequency[1])
    around = median_filter(total, 2 * round(AROUND_HZ / step) + 1, mode="nearest")
    inner = (frequency > ABOVE_HZ) & (frequency < 0.45 * rate_hz)
    ratio = np.where(inner, total / np.maximum(around, 1e-300), 0.0)
    peak = int(ratio.argmax())
    power = density[max(peak - 3, 0) : peak + 4].sum(axis=0) * step
    found = bool(ratio[peak] > STANDS_OUT)
    return Spectrum(
        frequency,
        density,
        sosfiltfilt(highpass, signal, axis=0).std(axis=0),
        np.sqrt(0.5 * np.median(density[inside], axis=0)),
        float(frequency[peak]) if found else float("nan"),
        np.sqrt(2.0 * power) if found else np.full(3, np.nan),
    )


def spectra_in_flight(flight: Flight) -> tuple[Spectrum, Spectrum]:
    """Gyroscope and accelerometer from the first to the last second that is not at rest."""
    second, still = round(flight.rate_hz), _still(flight)
    busy = np.flatnonzero(~still)
    air = flight.part(int(busy[0]) * second, int(busy[-1] + 1) * second) if len(busy) else flight
    return spectrum(air.gyro, air.rate_hz), spectrum(air.accel, air.rate_hz)


def spectra_at_rest(flight: Flight) -> tuple[Spectrum, Spectrum] | None:
    """Gyroscope and accelerometer over the longest rest of 3 s and more; None if there is none."""
    second = round(flight.rate_hz)
    start, end = longest_stretch(_still(flight))
    if end - start < REST_S:
        return None
    rest = flight.part(start * second, end * second)
    return spectrum(rest.gyro, rest.rate_hz, RESTING), spectrum(rest.accel, rest.rate_hz, RESTING)


def _still(flight: Flight) -> NDArray[np.bool_]:
    """Whether each second rests: its readings shake no more than a sensor's own noise."""
    gyro, accel = (
        blocks_of(values, round(flight.rate_hz)).std(axis=1).max(axis=1)
        for values in (flight.gyro, flight.accel)
    )
    return (gyro < STILL_GYRO) & (accel < STILL_ACCEL)
