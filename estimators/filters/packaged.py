"""Filters of other packages, with one object per vehicle.

VQF, the versatile quaternion-based filter, is the authors' C++ code with six axes: D. Laidig, T. Seel, "VQF:
Highly accurate IMU orientation estimation with bias estimation and magnetic disturbance rejection",
Information Fusion 91, 2023. Its low-pass starts as a running mean. With an unknown initial attitude, VQF
therefore starts with the inclination of the first specific force and converges within `tauAcc`. After a gap
in which the vehicle may have rotated by more than `LOST`, VQF starts again in this way, with the estimated
bias.

The others are quaternion Kalman filters with filterpy's classes. `ekf-filterpy` gives the same numbers as
`ekf`. `ukf-filterpy` has the same model with scaled sigma points (van der Merwe); the measurement of a sigma
point is R(q)ᵀ (0, 0, 1) of its normalised quaternion.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray
from vqf import VQF

from quadsim.rotation import euler_core, quat_from_rotvec, roll_pitch_from_quat
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from .driver import BatchedFilter
from .ekf import SIGMA_KNOWN, SIGMA_UNKNOWN
from .samples import sanitise

Array = NDArray[np.float64]

LOST = math.radians(10.0)
"""Standard deviation of an unmeasured rotation after which VQF starts again [rad], reached in a gap of 0.25
s."""
SWITCHES = ("motionBiasEstEnabled", "restBiasEstEnabled")


ALPHA, BETA, KAPPA = 0.1, 2.0, 0.0
"""Parameters of the scaled sigma points, with the usual values for a Gaussian."""


def up_of_quat(q: Array) -> Array:
    """Return the predicted measurement h(q), quadratic in q, which is R(q)ᵀ (0, 0, 1) for a unit q."""
    w, x, y, z = q
    return np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z])


def up_jacobian(q: Array) -> Array:
    """Return ∂h/∂q, (3, 4)."""
    w, x, y, z = q
    return 2.0 * np.array([[-y, z, -w, x], [x, w, z, y], [w, -x, -y, z]])


def product_matrix(p: Array) -> Array:
    """Return the matrix F of q ⊗ p = F q, (4, 4)."""
    w, x, y, z = p
    return np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])


class Vqf(BatchedFilter):
    """VQF for n vehicles."""

    def __init__(self, name: str, rate_hz: float, values: Mapping[str, float]) -> None:
        """Make the filter as `BatchedFilter`.

        The values are parameters of the package, with switches as 0 or 1.
        """
        self._options: dict[str, Any] = {**values} | {key: bool(values[key]) for key in SWITCHES}
        super().__init__(name, rate_hz, values)

    @property
    def quat(self) -> Array:
        """Estimated quat_WB (n, 4)."""
        return np.array([each.getQuat6D() for each in self.state])

    @property
    def gyro_bias(self) -> Array:
        """Estimated gyroscope bias (n, 3) [rad/s]."""
        return np.array([each.getBiasEstimate()[0] for each in self.state])

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for copies and pickles, which objects of the package do not support."""
        return vars(self) | {"state": [each.state for each in self.state]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the state of `__getstate__`."""
        vars(self).update(state)
        self.state = self._made(len(state["state"]))
        for each, its in zip(self.state, state["state"], strict=True):
            each.state = its

    def _made(self, n: int) -> NDArray[Any]:
        return np.array([VQF(self._dt, **self._options) for _ in range(n)], dtype=object)

    def _started(self, quat: Array, known: bool) -> NDArray[Any]:
        filters = self._made(len(quat))
        if known:
            for each, q in zip(filters, quat, strict=True):
                _start_at(each, q)
        return filters

    def _run(self, gyro: Array, accel: Array, rotors: Array) -> Array:
        rate, _, force, _, ended = sanitise(self._samples, self._dt, gyro, accel)
        samples = zip(self.state, rate, force, ended > LOST * LOST, strict=True)
        return np.stack([roll_pitch(_quats(*each)) for each in samples])


class FilterpyEkf(BatchedFilter):
    """Extended Kalman filter with filterpy's classes, for n vehicles."""

    @property
    def quat(self) -> Array:
        """Estimated quat_WB (n, 4)."""
        return np.array([kf.x for kf in self.state])

    def _made(self) -> Any:
        return ExtendedKalmanFilter(dim_x=4, dim_z=3)

    def _take(self, kf: Any, transition: Array, direction: Array | None) -> None:
        """Predict, and correct by a direction of the specific force, if there is one."""
        kf.F = transition
        kf.predict()
        if direction is not None:
            kf.update(direction, up_jacobian, up_of_quat)

    def _started(self, quat: Array, known: bool) -> NDArray[Any]:
        filters = np.array([self._made() for _ in quat], dtype=object)
        for kf, q in zip(filters, quat, strict=True):
            kf.x, kf.P = q.copy(), 0.25 * (SIGMA_KNOWN if known else SIGMA_UNKNOWN) ** 2 * np.eye(4)
            kf.R = self.values["accel_noise"] ** 2 / self._dt * np.eye(3)
        return filters

    def _run(self, gyro: Array, accel: Array, rotors: Array) -> Array:
        _, rate, force, unseen, _ = sanitise(self._samples, self._dt, gyro, accel)
        step = quat_from_rotvec(rate * self._dt)
        walk = 0.25 * self.values["gyro_noise"] ** 2 * self._dt
        quats = np.empty((*gyro.shape[:2], 4))
        for i, kf in enumerate(self.state):
            for t in range(gyro.shape[1]):
                kf.Q = walk * np.eye(4) + 0.25 * unseen[i, t] * np.eye(4)
                length = np.sqrt(force[i, t] @ force[i, t])
                self._take(kf, product_matrix(step[i, t]), force[i, t] / length if length > 0.0 else None)
                kf.x = quats[i, t] = kf.x / np.sqrt(kf.x @ kf.x)
        return roll_pitch_from_quat(quats)


class FilterpyUkf(FilterpyEkf):
    """Unscented Kalman filter with filterpy's classes, for n vehicles."""

    def _made(self) -> Any:
        points = MerweScaledSigmaPoints(4, ALPHA, BETA, KAPPA)
        return UnscentedKalmanFilter(4, 3, self._dt, _hx, _fx, points)

    def _take(self, kf: Any, transition: Array, direction: Array | None) -> None:
        kf.predict(transition=transition)
        if direction is not None:
            kf.update(direction)


def _fx(q: Array, dt: float, transition: Array) -> Array:
    return transition @ q


def _hx(q: Array) -> Array:
    return up_of_quat(q) / (q @ q)


@njit(cache=True, error_model="numpy")
def roll_pitch(quats):
    """Return roll and pitch (k, 2) [rad] of quaternions (k, 4), faster than `roll_pitch_from_quat`."""
    out = np.empty((quats.shape[0], 2))
    for i in range(quats.shape[0]):
        out[i, 0], out[i, 1], _ = euler_core(quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3])
    return out


def _quats(vqf: VQF, rate: Array, force: Array, lost: NDArray[np.bool_]) -> Array:
    """Return quaternions (T, 4) for samples (T, 3) of one vehicle.

    The filter restarts where `lost` (T,) is true.
    """
    if len(rate) == 1:  # faster than a batch of one
        if lost[0]:
            _start_again(vqf)
        vqf.update(rate[0], force[0])
        return vqf.getQuat6D()[None]
    parts = []
    for first, last in pairwise([0, *(k for k in np.flatnonzero(lost) if k > 0), len(rate)]):
        if lost[first]:
            _start_again(vqf)
        parts.append(vqf.updateBatch(rate[first:last], force[first:last])["quat6D"])
    return np.concatenate(parts)


def _start_again(vqf: VQF) -> None:
    """Restart VQF, but keep the gyroscope bias and its covariance."""
    old = vqf.state
    vqf.resetState()
    new = vqf.state
    for key in ("bias", "biasP"):
        new[key] = old[key]
    vqf.state = new


def _start_at(vqf: VQF, quat: Array) -> None:
    """Set VQF to an attitude, with the acceleration low-pass in the steady state of rest."""
    state, coefficients = vqf.state, vqf.coeffs
    b, a = np.asarray(coefficients["accLpB"]), np.asarray(coefficients["accLpA"])
    settled = [VQF.filterInitialState(level, b, a) for level in (0.0, 0.0, GRAVITY)]
    state["gyrQuat"] = quat.tolist()
    state["accLpState"] = np.concatenate(settled).tolist()
    state["lastAccLp"] = [0.0, 0.0, GRAVITY]
    vqf.state = state
