"""Logs of flights: every sample for the metrics, and signals of the first flight for the report.

Signals are readings, biases, wind, rotor commands and the estimator's standard deviation.
"""

import math
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator, Readings
from quadsim.flight.faults import Bias, sensor_faults
from quadsim.flight.mission import Mission
from quadsim.runs.compiled import njit
from quadsim.seeding import vehicle_seeds

from .flight_series import decimation

Array = NDArray[np.float64]
Log = NDArray[np.void]

VECTORS = ("gyro", "accel", "bias", "bias_est", "wind")
"""Signals with three axes: gyroscope [deg/s], accelerometer [m/s²], gyroscope bias in the readings and as
estimated [deg/s], wind in world axes [m/s]."""
SHARED = tuple(f"{name}_{axis}" for name in ("bias", "wind") for axis in "xyz")
"""Signals that depend only on seed and time, and not on the estimator."""


class Flown(NamedTuple):
    """Logs of the flights of a mission."""

    log: Log  #: (n, T) of `log_dtype`; what follows a crash means nothing
    end: NDArray[np.int64]  #: samples of each flight before its crash, (n,); T without one
    signals: Mapping[
        str, Array
    ]  #: of the first flight at `SERIES_HZ` or at every sample; NaN without a value


@cache
def log_dtype(rotors: int) -> np.dtype[np.void]:
    """Return the record type of a sample in the log."""
    return np.dtype(
        [
            ("position", "f8", 3),  # world [m]
            ("euler", "f8", 3),  # true roll, pitch, yaw [rad]
            ("estimate", "f8", 2),  # estimated roll, pitch [rad]
            ("target", "f8", 3),  # set-point, world [m]
            ("tracking", "f8"),  # angle between the true and the commanded thrust axis [rad]
            ("tilt", "f8"),  # [rad]
            ("rotor_vel", "f8", rotors),  # [rad/s]
            ("command_change", "f8"),  # RMS over the rotors, since the last sample [rad/s]
        ]
    )


def fly_mission(mission: Mission, seed: int, first: int = 0, *, every_sample: bool = False) -> Flown:
    """Simulate a mission, whose flights have the numbers `first`, `first` + 1, ... of the seed.

    Signals are recorded at `SERIES_HZ` or at every sample. An estimator with a `close` is always closed at
    the end.
    """
    try:
        return _fly(mission, seed, first, every_sample)
    finally:
        getattr(mission.estimator, "close", lambda: None)()


def _fly(mission: Mission, seed: int, first: int, every_sample: bool) -> Flown:
    mission.begin(vehicle_seeds(seed, first + mission.n)[first:])
    rotors, every = len(mission.vehicle.rotors), 1 if every_sample else decimation(mission.rate_hz)
    log, signals = np.zeros((mission.steps, mission.n), log_dtype(rotors)), []
    last_command = mission.controller.rotor_vel_cmd.copy()
    end = np.full(mission.n, mission.steps)
    faults = [f for f in mission.scenario.faults if isinstance(f, Bias)]
    add_bias = sensor_faults(faults, 1, mission.rate_hz, 0)
    for k in range(mission.steps):
        mission.step()
        write_row(mission.records, last_command, log[k])
        if k % every == 0:
            added = Readings(np.zeros((1, 3)), np.zeros((1, 3)))
            if add_bias is not None:
                add_bias(added, mission.k[:1])
            signals.append(_signals(mission, added.gyro[0]))
        if mission.crashed:
            end[(mission.cause > 0) & (end > k)] = k
    names = [f"{name}_{axis}" for name in VECTORS for axis in "xyz"]
    names += [*(f"rotor_{k}" for k in range(rotors)), "roll_sigma", "pitch_sigma"]
    return Flown(log.swapaxes(0, 1), end, dict(zip(names, np.array(signals).T, strict=True)))


def _signals(mission: Mission, added_bias: Array) -> Array:
    """Return the signals of the first flight at this sample, including biases by faults [rad/s]."""
    return np.concatenate(
        [
            np.degrees(mission.readings.gyro[0]),
            mission.readings.accel[0],
            np.degrees(added_bias + (0.0 if mission.imu is None else mission.imu.biases["gyro"][0])),
            np.degrees(_own(mission.estimator, "gyro_bias", mission.n, 3)),
            mission.air[0],
            mission.controller.rotor_vel_cmd[0],
            np.degrees(_own(mission.estimator, "roll_pitch_sigma", mission.n, 2)),
        ]
    )


def _own(estimator: AttitudeEstimator | None, name: str, n: int, width: int) -> Array:
    """Return a quantity that an estimator estimates for the first vehicle, (width,); NaN if it does not."""
    try:
        found = np.asarray(getattr(estimator, name, np.nan), dtype=np.float64)
    except (TypeError, ValueError):  # a user's attribute of that name that means something else
        found = np.empty(0)
    return found[0] if found.shape == (n, width) else np.full(width, np.nan)


@njit(cache=True)
def write_row(loops, last_command, row):
    """Write one sample of n flights to `row` (n,), and the command to `last_command` (n, rotors).

    `loops` are (n,) records of `quadsim.flight.world.loop_dtype`.
    """
    for i in range(row.shape[0]):
        out, p, c, target = row[i], loops[i].vehicle, loops[i].controller, loops[i].flight.target
        s, axis, estimate = p.state, c.thrust_axis, loops[i].measured.roll_pitch
        quat = s.quat
        w, x, y, z = quat[0], quat[1], quat[2], quat[3]
        up_x, up_y, up_z = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
        for j in range(3):
            out.position[j], out.target[j] = s.position[j], target.position[j]
        for j in range(2):
            out.euler[j], out.estimate[j] = p.roll_pitch[j], estimate[j]
        out.euler[2] = p.yaw
        cx = up_y * axis[2] - up_z * axis[1]
        cy = up_z * axis[0] - up_x * axis[2]
        cz = up_x * axis[1] - up_y * axis[0]
        dot = up_x * axis[0] + up_y * axis[1] + up_z * axis[2]
        out.tracking = math.atan2(math.sqrt(cx * cx + cy * cy + cz * cz), dot)
        out.tilt = math.atan2(math.sqrt(up_x * up_x + up_y * up_y), up_z)
        change, rotors = 0.0, s.rotor_vel.shape[0]
        for j in range(rotors):
            out.rotor_vel[j] = s.rotor_vel[j]
            change += (c.rotor_vel_cmd[j] - last_command[i, j]) ** 2
            last_command[i, j] = c.rotor_vel_cmd[j]
        out.command_change = math.sqrt(change / rotors)
