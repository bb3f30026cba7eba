"""What a network makes of its inputs (the study of the paper's Fig. 8), and what its neurons encode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadsim.rotation import quat_rotate_inverse
from quadsim.vehicle import GRAVITY

from ..evaluation.flights import Flights
from ..metrics import attitude_error
from ..networks.network import NetworkEstimator
from .activity import Activity

Array = NDArray[np.float64]
BINS = 15
QUANTITIES = ("roll", "pitch", "roll rate", "pitch rate")
SLOW_HZ, FAST_HZ = 0.2, 1.0
"""Attitude below the first is of the long time, above the second of the short."""


def manipulations(flights: Flights) -> dict[str, tuple[Array, Array]]:
    """Inputs (gyro, accel), each (n, T, 3), as they are and with one sensor changed.

    The paper's three: a gyroscope that reads zero; an accelerometer that reads zero; and one that always
    reads a level hover, so that the attitude θ_acc that follows from it is zero ("accel removed"). The fourth
    accelerometer reads gravity alone, in body axes, as if the vehicle never accelerated. A force of exactly
    zero is a missing sample to the encoder: the input of a network then stays 0 from the start, which is a
    level hover where the scaling has that offset.
    """
    up = np.broadcast_to([0.0, 0.0, GRAVITY], flights.accel.shape)
    gravity = quat_rotate_inverse(flights.quat, up)
    return {
        "intact": (flights.gyro, flights.accel),
        "gyro removed": (np.zeros_like(flights.gyro), flights.accel),
        "accel zero": (flights.gyro, np.zeros_like(flights.accel)),
        "accel removed": (flights.gyro, np.ascontiguousarray(up)),
        "accel = gravity": (flights.gyro, gravity),
    }


@dataclass(frozen=True)
class StimulusResponse:
    """What a network estimates from manipulated inputs."""

    error_deg: float
    """Mean absolute error of roll and pitch."""
    gain: float
    """Slope of the estimate over the truth: 1 follows, 0 does not."""
    slow_gain: float
    """The same of the parts of both below `SLOW_HZ`."""
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
        whole, slow, fast = (
            _gain(estimate, flights.truth, flights.rate_hz, low, high)
            for low, high in ((0.0, np.inf), (0.0, SLOW_HZ), (FAST_HZ, np.inf))
        )
        found[name] = StimulusResponse(
            attitude_error(estimate, flights.truth).mean, whole, slow, fast, estimate[0]
        )
    return found


def _gain(estimate: Array, truth: Array, rate_hz: float, low: float, high: float) -> float:
    """Slope of the estimate over the truth (n, T, 2), of frequencies from `low` to below `high` [Hz]."""
    hz = np.fft.rfftfreq(truth.shape[1], 1 / rate_hz)
    inside = (hz >= low) & (hz < high)
    ours, theirs = (np.fft.rfft(each, axis=1)[:, inside] for each in (estimate, truth))
    weights = np.where((hz[inside] == 0) | (hz[inside] == rate_hz / 2), 1.0, 2.0)[:, None]
    return float(np.sum(weights * (ours * theirs.conj()).real) / np.sum(weights * np.abs(theirs) ** 2))


@dataclass(frozen=True)
class TuningCurves:
    """Spike rates of all neurons against one quantity."""

    centres: Array
    """Of the bins, (bins,) [deg or deg/s]."""
    rates: Array
    """Spikes per step, (neurons, bins); NaN where the quantity was never in a bin."""
    explained: Array
    """Share of the variance of a neuron's smoothed rate that its curve explains, (neurons,)."""


def tuning_curves(activity: Activity, flights: Flights, smooth_s: float = 0.1) -> dict[str, TuningCurves]:
    """Mean rate of every neuron in bins of roll, pitch and their rates, which hold equally many samples.

    Args:
        activity: Of the network over these flights.
        flights: The flights.
        smooth_s: Length over which spikes are averaged before variances are taken [s].
    """
    samples = flights.gyro.shape[1]
    block = max(1, round(smooth_s * flights.rate_hz))
    blocks = samples // block
    per_sample = activity.spikes.shape[1] // samples
    n, _, neurons = activity.spikes.shape
    spikes = activity.spikes[:, : blocks * block * per_sample]
    rate = spikes.reshape(n, blocks, -1, neurons).mean(axis=2).reshape(-1, neurons)
    signals = np.degrees(np.concatenate([flights.truth, flights.gyro[..., :2]], axis=2))
    means = signals[:, : blocks * block].reshape(n, blocks, block, 4).mean(axis=2).reshape(-1, 4)
    return {name: _curve(rate, means[:, k]) for k, name in enumerate(QUANTITIES)}


def preferred(curves: dict[str, TuningCurves]) -> NDArray[np.int64]:
    """For each neuron the quantity that explains most of its rate, as an index into `QUANTITIES`."""
    return np.argmax([curves[name].explained for name in QUANTITIES], axis=0)


def _curve(rate: Array, quantity: Array) -> TuningCurves:
    edges = np.quantile(quantity, np.linspace(0, 1, BINS + 1))
    place = np.clip(np.searchsorted(edges, quantity, side="right") - 1, 0, BINS - 1)
    counts = np.bincount(place, minlength=BINS)
    sums = np.stack([np.bincount(place, each, BINS) for each in rate.T])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums / counts
        between = np.nansum(counts * (mean - rate.mean(axis=0)[:, None]) ** 2, axis=1) / len(rate)
        explained = np.nan_to_num(between / rate.var(axis=0))
    centres = np.bincount(place, quantity, BINS) / np.maximum(counts, 1)
    return TuningCurves(centres, mean, explained)
