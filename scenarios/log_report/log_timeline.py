"""What viewers show of estimators on a log."""

from collections.abc import Mapping
from operator import attrgetter

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from estimators.analysis.raster import spikes_of
from estimators.evaluation.beliefs import run_in_steps
from estimators.evaluation.logs import ScoredLog
from quadsim.estimator import AttitudeEstimator, Readings
from quadsim.pictures.timeline import Timeline, Trace, attitudes, axes_of
from quadsim.rotation import euler_from_quat
from quadsim.vehicle import load_vehicle

Array = NDArray[np.float64]

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
    sigma = attrgetter("roll_pitch_sigma")
    if not (hasattr(est, "sequence") and hasattr(est, "roll_pitch_sigma")) or np.shape(sigma(est)) != (1, 2):
        return None
    last, found = zip(*((last, sigma(est)[0]) for last, _ in run_in_steps(est, readings)), strict=True)
    samples = np.arange(readings.gyro.shape[1])
    return np.stack([np.interp(samples, last, each) for each in np.transpose(found)], axis=1)
