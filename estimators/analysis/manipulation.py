"""What a network makes of manipulated inputs, the study of the paper's Fig. 8."""

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
"""Attitude below the first is of the long time, above the second of the short."""


def manipulations(flights: Flights) -> dict[str, tuple[Array, Array]]:
    """Inputs (gyro, accel), each (n, T, 3), as they are and with one sensor changed.

    The paper's three: a gyroscope that reads zero; an accelerometer that reads zero; and one that always
    reads a level hover, so that the attitude θ_acc that follows from it is zero ("accel removed"). A force of
    exactly zero is a missing sample to the encoder: the input of a network then stays 0 from the start, which
    is a level hover where the scaling has that offset.
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
    """What a network estimates from manipulated inputs."""

    error_deg: float
    """Mean absolute error of roll and pitch."""
    slow_gain: float
    """Slope of the estimate over the truth, of the parts of both below `SLOW_HZ`: 1 follows, 0 does not."""
    fast_gain: float
    """The same above `FAST_HZ`."""
    estimate: Array
    """Roll and pitch of the first flight, (T, 2) [rad]."""


def responses(est: NetworkEstimator, flights: Flights) -> dict[str, StimulusResponse]:
    """Error and gain of a network under each manipulation, from an unknown start."""
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
    """Slope of the estimate over the truth (n, T, 2), of frequencies from `low` to below `high` [Hz]."""
    hz = np.fft.rfftfreq(truth.shape[1], 1 / rate_hz)
    inside = (hz >= low) & (hz < high)
    ours, theirs = (np.fft.rfft(each, axis=1)[:, inside] for each in (estimate, truth))
    weights = np.where((hz[inside] == 0) | (hz[inside] == rate_hz / 2), 1.0, 2.0)[:, None]
    return float(np.sum(weights * (ours * theirs.conj()).real) / np.sum(weights * np.abs(theirs) ** 2))
