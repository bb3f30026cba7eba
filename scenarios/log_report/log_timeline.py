"""What viewers show of estimators on a log."""

from collections.abc import Mapping
from operator import attrgetter

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from estimators.analysis.raster import spikes_of
from estimators.evaluation.logs import ScoredLog
from quadsim.estimator import AttitudeEstimator, Readings, accepted_sensors
from quadsim.pictures.timeline import Timeline, Trace, attitudes, axes_of
from quadsim.rotation import euler_from_quat
from quadsim.vehicle import load_vehicle

Array = NDArray[np.float64]

SIGMA_S = 0.1
"""Time between the samples at which an estimator is asked for its standard deviation [s]."""
DRAWN = "hummingbird"
"""The vehicle that is drawn where none is given."""
SENSORS = {"rotor_vel": ("rotor speed", "rad/s"), "mag": ("magnetic field", "T")}
"""Variables of a log beside the IMU's to the names and units of their traces."""


def timeline_of_log(
    log: xr.Dataset, scored: ScoredLog, made: Mapping[str, AttitudeEstimator], vehicle: str | None
) -> Timeline:
    """What viewers show of a log, and of estimators with the gyroscope as it reads.

    Args:
        log: From `quadsim.logs.read_log`.
        scored: The same log with the estimates.
        made: The estimators; they run again from an unknown start, for their spikes and standard deviations.
        vehicle: The airframe that is drawn, if it is known.
    """
    flights = scored.flights
    gyro, accel = flights.gyro[0], flights.accel[0]
    ran = {name: est for name, est in made.items() if name in scored.estimates}
    sigmas = {
        name: found for name, est in ran.items() if (found := sigma_of(est, flights.readings)) is not None
    }
    poses, traces = attitudes(euler_from_quat(log["quat"].to_numpy()[0]), scored.estimates, sigmas)
    traces |= {"gyroscope": axes_of("rad/s", gyro), "accelerometer": axes_of("m/s²", accel)}
    for name, (title, unit) in SENSORS.items():
        if name in log:
            curves = enumerate(log[name].to_numpy()[0].T)
            traces[title] = Trace(
                unit, {"xyz"[k] if name == "mag" else f"rotor {k}": each for k, each in curves}
            )
    position = log["position"].to_numpy()[0] if "position" in log else np.zeros_like(gyro)
    spikes = {
        f"{name} {population}": found
        for name, est in ran.items()
        for population, found in spikes_of(est, gyro, accel).items()
    }
    body = load_vehicle(vehicle or DRAWN)
    return Timeline(log["time"].to_numpy(), body, position, poses, gyro, accel, traces, spikes=spikes)


def sigma_of(est: AttitudeEstimator, readings: Readings) -> Array | None:
    """Standard deviation of roll and pitch of an estimator's estimates (T, 2) [rad]; None if it gives none.

    Args:
        est: The estimator; it is reset.
        readings: Of one recording (1, T, ·).
    """
    est.reset(1)
    sequence, sigma = getattr(est, "sequence", None), attrgetter("roll_pitch_sigma")
    if sequence is None or not hasattr(est, "roll_pitch_sigma") or np.shape(sigma(est)) != (1, 2):
        return None
    steps = readings.gyro.shape[1]
    every = max(round(SIGMA_S * est.rate_hz), 1)
    last = np.append(np.arange(every - 1, steps - 1, every), steps - 1)
    found = []
    for first, end in zip(np.append(0, last[:-1] + 1), last + 1, strict=True):
        part = readings.map(lambda each, first=first, end=end: each[:, first:end])
        part.give(sequence, accepted_sensors(sequence))
        found.append(sigma(est)[0])
    return np.stack([np.interp(np.arange(steps), last, each) for each in np.transpose(found)], axis=1)
