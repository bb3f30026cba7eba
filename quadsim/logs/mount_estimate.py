"""Estimate how the IMU is mounted, from how the truth turns or from where the force points in hover."""

import warnings
from typing import NamedTuple, cast

import numpy as np
from scipy.spatial.transform import Rotation

from ..rotation import matrix_from_quat, quat_from_roll_pitch
from ..vehicle import GRAVITY
from .mean_force import Level, level
from .mounting import Mount, mount_matrix
from .recording import Array, Recording
from .resample import resample
from .truth_delay import turns, turns_at_delay

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

    @property
    def angle_deg(self) -> float:
        """Angle of the rotation [deg]."""
        return float(np.degrees(Rotation.from_matrix(self.body_from_imu).magnitude()))


def mount_from_level(found: Level) -> MountEstimate:
    """The mounting at which the mean force is along body z; its heading is taken as zero.

    roll = atan2(f_y, f_z), pitch = atan2(−f_x, √(f_y² + f_z²)), the attitude of a sensor at rest. The
    standard deviation is that of the mean and of an accelerometer's bias.
    """
    x, y, z = found.force
    across = float(np.hypot(y, z))
    steep = across < 0.02 * abs(x)  # x is up or down: any roll is the same
    roll, pitch = 0.0 if steep else float(np.arctan2(y, z)), float(np.arctan2(-x, across))
    by = f"the mean force of {found.seconds} s " + ("of hover" if found.hover else "in motion")
    sd = float(np.hypot(found.sd_deg, np.degrees(BIAS / GRAVITY)))
    return MountEstimate(matrix_from_quat(quat_from_roll_pitch([roll, pitch])), (sd, sd, np.inf), by)


def mount_from_truth(gyro: Array, quat: Array, rate_hz: float) -> MountEstimate:
    """The rotation that brings the gyroscope's rates nearest to those of the true attitude.

    Wahba's problem, min Σ |ω_truth − R ω_gyro|² (Markley 1988), of rates over spans that do not overlap, the
    mean of both and the truth's delay taken out.

    Args:
        gyro: (T, 3) [rad/s], NaN where missing.
        quat: quat_WB of the body (T, 4), NaN where not known.
        rate_hz: Samples per second.

    Raises:
        ValueError: Too little motion, or about one axis alone.
    """
    rates = turns(gyro, quat, rate_hz)
    if rates is None:
        raise ValueError("the truth and the gyroscope turn too little together: fly rolls and pitches")
    measured, true, scale = turns_at_delay(rates, rate_hz)
    with warnings.catch_warnings(
        action="ignore", category=UserWarning
    ):  # of an axis without motion: see below
        found = Rotation.align_vectors(true, measured / scale, return_sensitivity=True)
    rotation, distance, sensitivity = cast("tuple[Rotation, float, Array]", found)
    sd = np.degrees(np.sqrt(np.diag(sensitivity) * distance**2 / (3 * len(true))))
    if not (sd < LARGEST_SD_DEG).all():
        raise ValueError(
            f"the mounting is uncertain by {sd.max():.0f}° (1 SD): the truth has to turn about two axes, and "
            "as the gyroscope does"
        )
    x, y, z = sd.tolist()
    return MountEstimate(np.asarray(rotation.as_matrix()), (x, y, z), f"{len(true)} turns of the truth")


def estimate_mount(log: Recording, given: Mount | None = None, from_level: bool = False) -> MountEstimate:
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
            found = mount_from_truth(gyro, quat, rate_hz)
        else:
            mean = level(gyro, accel, rate_hz)
            if mean is None:
                raise ValueError("no second without missing samples")
            if mean.sd_deg > LARGEST_SD_DEG:
                raise ValueError(f"the mean force has no steady direction: {mean.sd_deg:.0f}° (1 SD)")
            found = mount_from_level(mean)
    except ValueError as error:
        raise ValueError(f"{log.path or log.name}: {error}") from None
    return found if given is None else found._replace(body_from_imu=found.body_from_imu @ mount_matrix(given))
