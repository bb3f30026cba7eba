"""Response of a network to manipulated inputs, as in the paper's Fig. 8."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadsim.vehicle import GRAVITY

from ..evaluation.flights import Flights
from ..metrics import attitude_error
from ..networks.network import NetworkEstimator

Array = NDArray[np.float64]
SLOW_HZ, FAST_HZ = 0.2, 1.0
"""Frequencies [Hz] below which attitude counts as slow, and above which it counts as fast."""


def manipulations(flights: Flights) -> dict[str, tuple[Array, Array]]:
    """Return inputs (gyro, accel), (n, T, 3) each, unchanged and with one sensor changed.

    The paper makes three changes: the gyroscope reads zero; the accelerometer reads zero; or the
    accelerometer always reads level hover, so that the attitude θ_acc derived from it is zero ("accel
    removed"). The encoder treats a force of exactly zero as a missing sample, so the input of the network
    stays 0, which is level hover if the scaling has that offset.
    """
    up = np.broadcast_to([0.0, 0.0, GRAVITY], flights.accel.shape)
    return {
        "intact": (flights.gyro, flights.accel),
        "gyro removed": (np.zeros_like(flights.gyro), flights.accel),
        "accel zero": (flights.gyro, np.zeros_like(flights.accel)),
        "accel removed": (flights.gyro, np.ascontiguousarray(up)),
    }


@dataclass(frozen=True)
class StimulusResponse:
    """Response of a network to manipulated inputs."""

    error_deg: float
    """Mean absolute error of roll and pitch [deg]."""
    slow_gain: float
    """Slope of the estimate over the truth, for frequencies below `SLOW_HZ`; 1 is perfect tracking, 0 is
    none."""
    fast_gain: float
    """Slope of the estimate over the truth, for frequencies above `FAST_HZ`."""
    estimate: Array
    """Roll and pitch of the first flight, (T, 2) [rad]."""


def responses(est: NetworkEstimator, flights: Flights) -> dict[str, StimulusResponse]:
    """Return error and gains of a network for each manipulation, from an unknown start."""
    found = {}
    for name, (gyro, accel) in manipulations(flights).items():
        est.reset(len(gyro))
        estimate = est.sequence(gyro, accel)
        slow, fast = (
            _gain(estimate, flights.truth, flights.rate_hz, low, high)
            for low, high in ((0.0, SLOW_HZ), (FAST_HZ, np.inf))
        )
        error = attitude_error(estimate, flights.truth).mean
        found[name] = StimulusResponse(error, slow, fast, estimate[0])
    return found


def _gain(estimate: Array, truth: Array, rate_hz: float, low: float, high: float) -> float:
    """Return the slope of the estimate over the truth (n, T, 2), for frequencies `low` to `high` [Hz]."""
    hz = np.fft.rfftfreq(truth.shape[1], 1 / rate_hz)
    inside = (hz >= low) & (hz < high)
    ours, theirs = (np.fft.rfft(each, axis=1)[:, inside] for each in (estimate, truth))
    weights = np.where((hz[inside] == 0) | (hz[inside] == rate_hz / 2), 1.0, 2.0)[:, None]
    return float(np.sum(weights * (ours * theirs.conj()).real) / np.sum(weights * np.abs(theirs) ** 2))
