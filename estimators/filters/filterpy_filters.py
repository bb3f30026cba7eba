"""The quaternion Kalman filters on filterpy's own classes, one object per vehicle.

`ekf-filterpy` is the filter of `ekf`, number for number. `ukf-filterpy` has the same model with scaled sigma
points (van der Merwe), each measured as the direction R(q)ᵀ (0, 0, 1) of the unit quaternion along it.
"""

from typing import Literal, Unpack

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import OtherSensors
from quadsim.rotation import quat_from_rotvec, roll_pitch_from_quat

from .algorithm import initial_quat, paired
from .ekf import SIGMA_KNOWN, SIGMA_UNKNOWN
from .samples import initial_states, sanitise

Array = NDArray[np.float64]

ALPHA, BETA, KAPPA = 0.1, 2.0, 0.0
"""Scaling of the sigma points, and the usual choices for a Gaussian."""


def up_in_body(q: Array) -> Array:
    """Predicted measurement h(q), quadratic in q: the direction R(q)ᵀ (0, 0, 1) for a unit q."""
    w, x, y, z = q
    return np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z])


def up_jacobian(q: Array) -> Array:
    """∂h/∂q, (3, 4)."""
    w, x, y, z = q
    return 2.0 * np.array([[-y, z, -w, x], [x, w, z, y], [w, -x, -y, z]])


def product_matrix(p: Array) -> Array:
    """The matrix F of q ⊗ p = F q, (4, 4)."""
    w, x, y, z = p
    return np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])


class FilterpyFilter:
    """An extended or an unscented Kalman filter of filterpy for n vehicles."""

    def __init__(
        self, kind: Literal["ekf", "ukf"], rate_hz: float, gyro_noise: float, accel_noise: float
    ) -> None:
        """Make the filter for one vehicle; `reset` changes their number.

        Args:
            kind: Extended or unscented.
            rate_hz: Samples per second.
            gyro_noise: Noise density of the rate [rad/√s].
            accel_noise: Noise density of the measured direction [√s].
        """
        self.kind, self.rate_hz, self._dt = kind, rate_hz, 1.0 / rate_hz
        self._process = 0.25 * gyro_noise**2 * self._dt * np.eye(4)
        self._measurement = accel_noise**2 / self._dt * np.eye(3)
        self.reset()

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None) -> None:
        """Start n vehicles: level, or at a known attitude, roll_pitch (n, 2) [rad] or quat_WB (n, 4)."""
        self._samples, self.filters = initial_states(n), self._started(n, roll_pitch, quat)

    def restart(
        self, ids: ArrayLike, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None
    ) -> None:
        """Start some of the vehicles again, the others fly on; attitudes (len(ids), ·) as in `reset`."""
        rows = np.atleast_1d(np.asarray(ids, dtype=np.intp))
        if rows.size > 0:
            self._samples[rows] = initial_states(rows.size)
            for i, each in zip(rows, self._started(rows.size, roll_pitch, quat), strict=True):
                self.filters[i] = each

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take one sample (n, 3) [rad/s], (n, 3) [m/s²]; roll and pitch (n, 2) [rad]."""
        return self.sequence(np.asarray(gyro)[:, None], np.asarray(accel)[:, None])[:, 0]

    def sequence(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take (n, T, 3) samples, carrying on from the last; roll and pitch (n, T, 2) [rad]."""
        gyro, accel = paired(gyro, accel)
        if len(gyro) != len(self.filters):
            raise ValueError(f"gyro holds {len(gyro)} vehicles; reset was for {len(self.filters)}")
        rate, force, unseen = sanitise(self._samples, self._dt, gyro, accel, True)
        step = quat_from_rotvec(rate * self._dt)
        quats = np.empty((*gyro.shape[:2], 4))
        for i, kf in enumerate(self.filters):
            for t in range(gyro.shape[1]):
                kf.Q = self._process + 0.25 * unseen[i, t] * np.eye(4)
                quats[i, t] = self._step(kf, product_matrix(step[i, t]), force[i, t])
        return roll_pitch_from_quat(quats)

    @property
    def quat(self) -> Array:
        """Estimated quat_WB (n, 4)."""
        return np.array([kf.x for kf in self.filters])

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Samples since reset that were missing in part or whole, (n,)."""
        return self._samples["skipped"].astype(np.int64)

    def _started(
        self, n: int, roll_pitch: ArrayLike | None, quat: ArrayLike | None
    ) -> list[ExtendedKalmanFilter | UnscentedKalmanFilter]:
        attitude, known = initial_quat(n, roll_pitch, quat)
        covariance = 0.25 * (SIGMA_KNOWN if known else SIGMA_UNKNOWN) ** 2 * np.eye(4)
        return [self._filter(q, covariance) for q in attitude]

    def _filter(self, quat: Array, covariance: Array) -> ExtendedKalmanFilter | UnscentedKalmanFilter:
        if self.kind == "ekf":
            kf = ExtendedKalmanFilter(dim_x=4, dim_z=3)
        else:
            points = MerweScaledSigmaPoints(4, ALPHA, BETA, KAPPA)
            kf = UnscentedKalmanFilter(4, 3, self._dt, _hx, _fx, points)
        kf.x, kf.P = quat.copy(), covariance.copy()
        kf.Q, kf.R = self._process, self._measurement
        return kf

    def _step(
        self, kf: ExtendedKalmanFilter | UnscentedKalmanFilter, transition: Array, force: Array
    ) -> Array:
        length = np.sqrt(force @ force)
        if isinstance(kf, ExtendedKalmanFilter):
            kf.F = transition
            kf.predict()
            if length > 0.0:
                kf.update(force / length, up_jacobian, up_in_body)
        else:
            kf.predict(transition=transition)
            if length > 0.0:
                kf.update(force / length)
        kf.x = kf.x / np.sqrt(kf.x @ kf.x)
        return kf.x


def _fx(q: Array, dt: float, transition: Array) -> Array:
    return transition @ q


def _hx(q: Array) -> Array:
    return up_in_body(q) / (q @ q)
