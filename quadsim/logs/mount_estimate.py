"""Estimate how the IMU is mounted, from how the truth turns or from where the force points in hover."""

import math
import warnings
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from scipy.spatial.transform import Rotation

from ..rotation import quat_rotate_inverse
from ..runs.console import print_table, say
from ..vehicle import GRAVITY
from .mean_force import Level, level
from .recording import Array, Recording, mount_matrix, mount_text
from .resample import resample
from .truth_delay import turns_at_delay

BIAS = 0.196
"""Standard deviation of an accelerometer's turn-on bias [m/s²]: the ADIS16448's in RotorS."""
LARGEST_SD_DEG = 5.0
"""An estimate that is less certain about an axis is refused [deg]."""


class MountEstimate(NamedTuple):
    """An estimated mounting."""

    body_from_imu: Array
    """Rotation from IMU to body axes (3, 3)."""
    sd_deg: tuple[float, float, float]
    """Standard deviation about body x, y, z [deg]; infinite about z where the heading does not show."""
    by: str
    """What it was estimated from."""
    accel_bias: Array | None = None
    """Accelerometer's bias across body z (2,) [m/s²]; None where it cannot be separated from a tilt."""
    levelled: bool = False
    """Whether the tilt is that of the mean force, because the bias hides a part of the IMU's tilt."""


def mount_from_level(found: Level | None) -> MountEstimate:
    """The mounting at which the mean force is along body z; its heading is taken as zero.

    The standard deviation is that of the mean and of an accelerometer's bias.
    """
    if found is None:
        raise ValueError("no second without missing samples")
    if found.sd_deg > LARGEST_SD_DEG:
        raise ValueError(f"the mean force has no steady direction: {found.sd_deg:.0f}° (1 SD)")
    by = f"the mean force of {found.seconds} s {'of hover' if found.hover else 'in motion'}"
    sd = float(np.hypot(found.sd_deg, np.degrees(BIAS / GRAVITY)))
    return MountEstimate(found.mount, (sd, sd, np.inf), by)


def mount_from_truth(gyro: Array, quat: Array, rate_hz: float) -> MountEstimate:
    """The rotation that brings the gyroscope's rates nearest to those of the true attitude.

    Wahba's problem, min Σ |ω_truth − R ω_gyro|² (Markley 1988), of rates over spans, the mean of both and the
    truth's delay taken out. Spans overlap, so that the noise of every sample of the truth is averaged; the
    standard deviation is that of as many as do not.

    Args:
        gyro: (T, 3) [rad/s], NaN where missing.
        quat: quat_WB of the body (T, 4), NaN where not known.
        rate_hz: Samples per second.

    Raises:
        ValueError: Too little motion, or about one axis alone.
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
    if not (sd < LARGEST_SD_DEG).all():
        raise ValueError(
            f"the mounting is uncertain by {sd.max():.0f}° (1 SD): the truth has to turn about two axes, and "
            "as the gyroscope does"
        )
    x, y, z = sd.tolist()
    return MountEstimate(np.asarray(rotation.as_matrix()), (x, y, z), f"{count} turns of the truth")


def with_accel_bias(found: MountEstimate, accel: Array, quat: Array) -> MountEstimate:
    """A mounting by the truth, with the accelerometer's bias: its mean less gravity's in body axes.

    Filters take the bias for a tilt. Where it hides a part of the IMU's tilt, so that more would show with
    the mounting than without, the tilt is that which brings the mean force onto gravity's: both together.

    Args:
        found: From `mount_from_truth`.
        accel: Specific force in IMU axes (T, 3) [m/s²], NaN where missing.
        quat: quat_WB of the body (T, 4), NaN where not known.
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
    levelling = Rotation.from_rotvec(axis / max(sine, 1e-12) * tilt)
    sd = np.hypot(found.sd_deg, np.degrees([tilt, tilt, 0.0]))
    body_from_imu = levelling.as_matrix() @ found.body_from_imu
    return found._replace(body_from_imu=body_from_imu, sd_deg=tuple(sd.tolist()), levelled=True)


def estimate_mount(log: Recording, given: str | None = None, from_level: bool = False) -> MountEstimate:
    """The mounting of an IMU, from a true attitude of the body where there is one, else from the mean force.

    Args:
        log: A recording.
        given: The mount that it was read with; the estimate includes it.
        from_level: From the mean force, although there is a true attitude.

    Raises:
        ValueError: Too little motion for the truth, or no complete second of samples.
    """
    data, _ = resample(log)
    rate_hz = float(data.attrs["rate_hz"])
    gyro, accel, quat = (data[name].to_numpy()[0] for name in ("gyro", "accel", "quat"))
    try:
        if np.isfinite(quat).any() and log.truth_axes == "body" and not from_level:
            found = with_accel_bias(mount_from_truth(gyro, quat, rate_hz), accel, quat)
        else:
            found = mount_from_level(level(gyro, accel, rate_hz))
    except ValueError as error:
        raise ValueError(f"{log.path or log.name}: {error}") from None
    return found if given is None else found._replace(body_from_imu=found.body_from_imu @ mount_matrix(given))


def show_estimate(path: Path, found: MountEstimate) -> None:
    """Print an estimated mounting, its uncertainty and the `--mount` that gives it."""
    x, y, z = found.sd_deg
    angle = np.degrees(Rotation.from_matrix(found.body_from_imu).magnitude())
    rows = {
        "from": found.by,
        "rotation": f"{angle:.2f}°",
        "1 SD about body x, y": f"{x:.2f}°, {y:.2f}°",
        "1 SD about body z": f"{z:.2f}°" if z < math.inf else "the heading does not show",
    }
    if found.accel_bias is not None:
        x, y = found.accel_bias
        rows["accelerometer bias, body x, y"] = f"{x:+.2f}, {y:+.2f} m/s²"
    print_table(rows.items())
    if found.accel_bias is None:
        text = "the log cannot separate the accelerometer's bias from a tilt of the IMU"
        say(f"! {text}: the mount takes both together")
    elif found.levelled:
        text = "the accelerometer's bias hides a part of the IMU's tilt: the mount takes both together"
        say(f"! {text}, so that no filter's error rises")
    say(f'{path}: --mount "{mount_text(found.body_from_imu)}"')
