"""Estimation of the IMU's mounting, from the true attitude or from the mean specific force.

Signals are evenly sampled: `gyro` (T, 3) [rad/s] and `accel` (T, 3) [m/s²], NaN where missing, and the true
attitude `quat` (T, 4), quat_WB of the body, NaN where not known.
"""

import math
import warnings
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from ..dataset.stretches import blocks_of, stretches
from ..rotation import matrix_from_quat, quat_from_roll_pitch, quat_rotate_inverse, roll_pitch_of_up
from ..runs.console import print_table, say
from ..vehicle import GRAVITY
from .recording import Array, mount_matrix, mount_text
from .thresholds import MOUNT
from .truth import turns_at_delay

BIAS = 0.196
"""Standard deviation of an accelerometer's turn-on bias [m/s²]: the ADIS16448's in RotorS."""


class MeanForce(NamedTuple):
    """Mean direction of the specific force."""

    force: Array
    """Mean specific force in IMU axes (3,) [m/s²]."""
    sd_deg: float
    """Standard deviation of the direction of the mean, from the scatter between seconds [deg]."""
    seconds: int
    hover: bool
    """Whether only seconds of hover or rest are used; otherwise, all seconds of the log are used."""

    @property
    def tilt_deg(self) -> float:
        """Angle between the mean force and z [deg]."""
        return float(np.degrees(np.arctan2(np.hypot(*self.force[:2]), self.force[2])))

    @property
    def mount(self) -> Array:
        """Rotation that aligns the mean force with body z without a change of heading, (3, 3)."""
        roll, pitch = roll_pitch_of_up(self.force)
        steep = np.hypot(*self.force[1:]) < 0.02 * abs(self.force[0])  # x is up or down: any roll is the same
        return matrix_from_quat(quat_from_roll_pitch([0.0 if steep else roll, pitch]))


class Rest(NamedTuple):
    """A part of a log at rest."""

    seconds: int
    rate: float
    """Mean rate of the gyroscope perpendicular to the specific force, which is its bias [rad/s]."""


class MountEstimate(NamedTuple):
    """An estimated mounting."""

    body_from_imu: Array
    """Rotation from IMU to body axes (3, 3)."""
    sd_deg: tuple[float, float, float]
    """Standard deviation about body x, y, z [deg]; infinite about z if the heading cannot be determined."""
    by: str
    """Source of the estimate, in words."""
    accel_bias: Array | None = None
    """Accelerometer bias along body x and y (2,) [m/s²]; None if it cannot be separated from a tilt."""
    levelled: bool = False
    """Whether the tilt is that of the mean force, because the bias compensates a part of the IMU's tilt."""


def level(gyro: Array, accel: Array, rate_hz: float) -> MeanForce | None:
    """Return the mean specific force in seconds of hover, or in all seconds if there are too few.

    The result is None without complete seconds.
    """
    rates, forces = (blocks_of(each, round(rate_hz)) for each in (gyro, accel))
    complete = np.isfinite(rates).all(axis=(1, 2)) & np.isfinite(forces).all(axis=(1, 2))
    rates, forces = rates[complete], forces[complete].mean(axis=1)
    if not len(forces):
        return None
    hover = np.linalg.norm(rates.mean(axis=1), axis=1) < MOUNT.hover_rate
    hover &= np.sqrt((rates**2).sum(axis=2).mean(axis=1)) < MOUNT.hover_rms
    hover &= np.abs(np.linalg.norm(forces, axis=1) / GRAVITY - 1.0) < MOUNT.hover_force
    alone = int(hover.sum()) >= MOUNT.least_hover_s
    forces = forces[hover] if alone else forces
    mean = forces.mean(axis=0)
    scatter = forces.std(axis=0) / np.sqrt(len(forces)) / max(float(np.linalg.norm(mean)), 1e-9)
    return MeanForce(mean, float(np.degrees(np.linalg.norm(scatter))), len(forces), alone)


def turn_at_rest(gyro: Array, accel: Array, rate_hz: float) -> Rest | None:
    """Return the part at rest in which the gyroscope rotates the vertical most.

    The result is None if there is no such part.

    A sensor is at rest in seconds in which the specific force equals gravity within 10 % and is nearly
    constant. The rotation is that of the mean rate ω perpendicular to the force. In a steady banked turn, the
    angle between ω and the force is the bank angle, which is below 25° if the force is below 1.1 g.
    Therefore, an ω within 30° of the force counts as 0.
    """
    rates, forces = (blocks_of(each, round(rate_hz)) for each in (gyro, accel))
    means, rates = forces.mean(axis=1), rates.mean(axis=1)
    size = np.linalg.norm(means, axis=1)
    steady = np.isfinite(rates).all(axis=1)
    steady &= np.linalg.norm(forces.std(axis=1), axis=1) < MOUNT.rest_share * size
    steady &= np.abs(size / GRAVITY - 1.0) < MOUNT.hover_force
    found: list[Rest] = []
    for begin, last in stretches(steady):
        start = begin
        for k in range(begin + 1, last + 1):
            if k == last or np.linalg.norm(means[k] - means[start]) > MOUNT.rest_share * size[start]:
                mean = rates[start:k].mean(axis=0)
                across = float(np.linalg.norm(np.cross(means[start] / size[start], mean)))
                found.append(Rest(k - start, across if across > 0.5 * float(np.linalg.norm(mean)) else 0.0))
                start = k
    return max(found, key=lambda rest: rest.rate * rest.seconds, default=None)


def estimate_mount(log: xr.Dataset, given: str | None = None, from_level: bool = False) -> MountEstimate:
    """Estimate the mounting of an IMU from the body's true attitude or, without one, from the mean force.

    Args:
        log: A log from `read_log`.
        given: The mount that the log was read with; the estimate includes this mount.
        from_level: Use the mean force even if there is a true attitude.

    Raises:
        ValueError: There is too little motion to use the true attitude, or no complete second of samples.
    """
    report, rate_hz = log.attrs["log"], float(log.attrs["rate_hz"])
    gyro, accel, quat = (log[name].to_numpy()[0] for name in ("gyro", "accel", "quat"))
    try:
        if np.isfinite(quat).any() and report.log.truth_axes == "body" and not from_level:
            found = _with_accel_bias(_mount_from_truth(gyro, quat, rate_hz), accel, quat)
        else:
            found = _mount_from_level(level(gyro, accel, rate_hz))
    except ValueError as error:
        raise ValueError(f"{report.log.path}: {error}") from None
    return found if given is None else found._replace(body_from_imu=found.body_from_imu @ mount_matrix(given))


def _mount_from_level(found: MeanForce | None) -> MountEstimate:
    """Return the mounting that aligns the mean force with body z, without a change of heading.

    The standard deviation combines those of the mean and of the accelerometer bias.
    """
    if found is None:
        raise ValueError("no second without missing samples")
    if found.sd_deg > MOUNT.largest_sd_deg:
        raise ValueError(f"the mean force has no steady direction: {found.sd_deg:.0f}° (1 SD)")
    sd = float(np.hypot(found.sd_deg, np.degrees(BIAS / GRAVITY)))
    by = f"the mean force of {found.seconds} s {'of hover' if found.hover else 'in motion'}"
    return MountEstimate(found.mount, (sd, sd, np.inf), by)


def _mount_from_truth(gyro: Array, quat: Array, rate_hz: float) -> MountEstimate:
    """Return the rotation that best aligns the gyroscope's rates with those of the true attitude.

    This is Wahba's problem, min Σ |ω_truth − R ω_gyro|² (Markley 1988), for mean rates over spans of time.
    The means of both signals and the delay of the truth are removed first. Spans overlap, which averages the
    noise of the truth. The standard deviation is computed for the number of spans without overlap.
    """
    rates = turns_at_delay(gyro, quat, rate_hz)
    if rates is None:
        raise ValueError("the truth and the gyroscope turn too little together: fly rolls and pitches")
    measured, true, span = rates
    count = len(true) // span
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # an axis without motion: see below
        found = Rotation.align_vectors(true, measured, return_sensitivity=True)
    rotation, distance, sensitivity = cast("tuple[Rotation, float, Array]", found)
    sd = np.degrees(np.sqrt(np.diag(sensitivity) * distance**2 / (3 * count)))
    if not (sd < MOUNT.largest_sd_deg).all():
        raise ValueError(
            f"the mounting is uncertain by {sd.max():.0f}° (1 SD): the truth has to turn about two axes, and "
            "as the gyroscope does"
        )
    return MountEstimate(np.asarray(rotation.as_matrix()), tuple(sd.tolist()), f"{count} turns of the truth")


def _with_accel_bias(found: MountEstimate, accel: Array, quat: Array) -> MountEstimate:
    """Add the accelerometer bias to a mounting from the truth: the mean force minus gravity in body axes.

    Filters interpret the bias as a tilt. If the bias compensates a part of the IMU's tilt, the mounting alone
    would increase the error. The mounting then aligns the mean force with gravity, which corrects tilt and
    bias together.
    """
    known = np.isfinite(accel).all(axis=1) & np.isfinite(quat).all(axis=1)
    force = accel[known].mean(axis=0)
    gravity = quat_rotate_inverse(quat[known], np.array([0.0, 0.0, GRAVITY])).mean(axis=0)
    mounted_force = found.body_from_imu @ force
    bias = (mounted_force - gravity)[:2]
    found = found._replace(accel_bias=bias)
    hidden = np.linalg.norm(bias) > np.linalg.norm((force - gravity)[:2])
    if not hidden or np.linalg.norm(gravity) < 0.5 * GRAVITY:
        return found
    axis = np.cross(mounted_force, gravity)
    sine = float(np.linalg.norm(axis))
    tilt = np.arctan2(sine, float(mounted_force @ gravity))
    levelled = Rotation.from_rotvec(axis / max(sine, 1e-12) * tilt).as_matrix() @ found.body_from_imu
    sd = np.hypot(found.sd_deg, np.degrees([tilt, tilt, 0.0]))
    return found._replace(body_from_imu=levelled, sd_deg=tuple(sd.tolist()), levelled=True)


def show_estimate(path: Path, found: MountEstimate) -> None:
    """Print an estimated mounting, its uncertainty and the corresponding value of `--mount`."""
    x, y, z = found.sd_deg
    rows = {
        "from": found.by,
        "rotation": f"{np.degrees(Rotation.from_matrix(found.body_from_imu).magnitude()):.2f}°",
        "1 SD about body x, y": f"{x:.2f}°, {y:.2f}°",
        "1 SD about body z": f"{z:.2f}°" if z < math.inf else "the heading does not show",
    }
    note = "the log cannot separate the accelerometer's bias from a tilt of the IMU"
    if found.accel_bias is not None:
        x, y = found.accel_bias
        rows["accelerometer bias, body x, y"] = f"{x:+.2f}, {y:+.2f} m/s²"
        note = "the accelerometer's bias hides a part of the IMU's tilt" if found.levelled else ""
    print_table(rows.items())
    if note:
        say(f"! {note}: the mount takes both together")
    say(f'{path}: --mount "{mount_text(found.body_from_imu)}"')
