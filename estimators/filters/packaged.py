"""Filters of other packages, one of their objects per vehicle.

VQF, the versatile quaternion-based filter, is its authors' C++, six axes: D. Laidig, T. Seel, "VQF: Highly
accurate IMU orientation estimation with bias estimation and magnetic disturbance rejection", Information
Fusion 91, 2023. Its low-pass starts as a running mean, so with an unknown initial attitude it takes the
inclination of the first specific force at once, and levels out over `tauAcc`, which is its own behaviour.
After a gap in which the vehicle may have turned by more than `LOST` it starts again like that, with the bias
that it had estimated.

The others are quaternion Kalman filters on filterpy's classes. `ekf-filterpy` is the filter of `ekf`, number
for number. `ukf-filterpy` has the same model with scaled sigma points (van der Merwe), each measured as the
direction R(q)ᵀ (0, 0, 1) of the unit quaternion along it.
"""

import math
from typing import Any, Literal, Unpack

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import ArrayLike, NDArray
from vqf import VQF

from quadsim.estimator import OtherSensors
from quadsim.rotation import euler_core, quat_from_rotvec, roll_pitch_from_quat
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from .algorithm import Parameter, initial_quat, paired
from .ekf import SIGMA_KNOWN, SIGMA_UNKNOWN
from .samples import initial_states, sanitise

Array = NDArray[np.float64]

PARAMETERS = {
    "tauAcc": Parameter(3.0, 0.1, 1000.0, minimum=1e-6),
    "motionBiasEstEnabled": Parameter(1.0, 0.0, 1.0, "linear", maximum=1.0, searched=False),
    "restBiasEstEnabled": Parameter(1.0, 0.0, 1.0, "linear", maximum=1.0, searched=False),
    "biasSigmaInit": Parameter(0.5, 0.01, 2.0, minimum=1e-9),
    "biasForgettingTime": Parameter(100.0, 10.0, 10_000.0, minimum=1e-6),
    "biasClip": Parameter(2.0, 0.1, 20.0, minimum=1e-9, searched=False),
    "biasSigmaMotion": Parameter(0.1, 0.01, 10.0, minimum=1e-9),
    "biasVerticalForgettingFactor": Parameter(1e-4, 1e-6, 1.0, minimum=1e-12, searched=False),
    "biasSigmaRest": Parameter(0.03, 1e-3, 10.0, minimum=1e-9),
    "restMinT": Parameter(1.5, 0.1, 30.0, searched=False),
    "restFilterTau": Parameter(0.5, 0.05, 10.0, minimum=1e-6, searched=False),
    "restThGyr": Parameter(2.0, 0.1, 20.0, searched=False),
    "restThAcc": Parameter(0.5, 0.05, 5.0, searched=False),
}
"""The package's own names, units and defaults (`vqf.VQFParams`), without those of the magnetometer."""
LOST = math.radians(10.0)
"""Standard deviation of an unseen turn after which VQF starts again [rad]: that of a gap of 0.25 s."""
SWITCHES = ("motionBiasEstEnabled", "restBiasEstEnabled")


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


class PackagedFilter:
    """Filters of a package for n vehicles; a child makes them, and runs them."""

    filters: list[Any]

    def __init__(self, rate_hz: float) -> None:
        """Make the filter for one vehicle; `reset` changes their number."""
        self.rate_hz, self._dt = rate_hz, 1.0 / rate_hz
        self.reset()

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None) -> None:
        """Start n vehicles: at an unknown attitude, or at roll_pitch (n, 2) [rad] or quat_WB (n, 4)."""
        self._samples, self._unseen = initial_states(n), np.zeros(n)
        self.filters = self._started(*initial_quat(n, roll_pitch, quat))

    def restart(
        self, ids: ArrayLike, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None
    ) -> None:
        """Start some of the vehicles again, the others fly on; attitudes (len(ids), ·) as in `reset`."""
        rows = np.atleast_1d(np.asarray(ids, dtype=np.intp))
        if rows.size > 0:
            self._samples[rows], self._unseen[rows] = initial_states(rows.size), 0.0
            started = self._started(*initial_quat(rows.size, roll_pitch, quat))
            for i, each in zip(rows, started, strict=True):
                self.filters[i] = each

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take one sample (n, 3) [rad/s], (n, 3) [m/s²]; roll and pitch (n, 2) [rad]."""
        return self.sequence(np.asarray(gyro)[:, None], np.asarray(accel)[:, None])[:, 0]

    def sequence(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take (n, T, 3) samples, carrying on from the last; roll and pitch (n, T, 2) [rad]."""
        raise NotImplementedError

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Samples since reset that were missing in part or whole, (n,)."""
        return self._samples["skipped"].astype(np.int64)

    def _started(self, quat: Array, known: bool) -> list[Any]:
        """Filters at quat_WB (n, 4), level if it is not known."""
        raise NotImplementedError

    def _paired(self, gyro: ArrayLike, accel: ArrayLike) -> tuple[Array, Array]:
        gyro, accel = paired(gyro, accel)
        if len(gyro) != len(self.filters):
            raise ValueError(f"gyro holds {len(gyro)} vehicles; reset was for {len(self.filters)}")
        return gyro, accel


class VqfFilter(PackagedFilter):
    """VQF for n vehicles."""

    def __init__(self, rate_hz: float, values: dict[str, float]) -> None:
        """Make the filter for one vehicle.

        Args:
            rate_hz: Samples per second.
            values: The package's parameters; switches are 0 or 1.
        """
        self.values = dict(values)
        self._options: dict[str, Any] = values | {key: bool(values[key]) for key in SWITCHES}
        super().__init__(rate_hz)

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take one sample (n, 3) [rad/s], (n, 3) [m/s²]; roll and pitch (n, 2) [rad]."""
        rate, force, lost = self._sanitised(np.asarray(gyro)[:, None], np.asarray(accel)[:, None])
        for i, each in enumerate(self.filters):
            if lost[i, 0]:
                _start_again(each)
            each.update(rate[i, 0], force[i, 0])
        return roll_pitch(self.quat)

    def sequence(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take (n, T, 3) samples, carrying on from the last; roll and pitch (n, T, 2) [rad]."""
        samples = self._sanitised(gyro, accel)
        quats = [_run(each, *sample) for each, *sample in zip(self.filters, *samples, strict=True)]
        return np.stack([roll_pitch(quat) for quat in quats])

    @property
    def quat(self) -> Array:
        """Estimated quat_WB (n, 4)."""
        return np.array([each.getQuat6D() for each in self.filters])

    @property
    def gyro_bias(self) -> Array:
        """Estimated gyroscope bias (n, 3) [rad/s]."""
        return np.array([each.getBiasEstimate()[0] for each in self.filters])

    def __getstate__(self) -> dict[str, Any]:
        """For copies and pickles: the package's objects have neither, but give their state."""
        return vars(self) | {"filters": [each.state for each in self.filters]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Undo `__getstate__`."""
        vars(self).update(
            state | {"filters": [VQF(state["_dt"], **state["_options"]) for _ in state["filters"]]}
        )
        for each, its in zip(self.filters, state["filters"], strict=True):
            each.state = its

    def _started(self, quat: Array, known: bool) -> list[VQF]:
        filters = [VQF(self._dt, **self._options) for _ in quat]
        if known:
            for each, q in zip(filters, quat, strict=True):
                _start_at(each, q)
        return filters

    def _sanitised(self, gyro: ArrayLike, accel: ArrayLike) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Rate and specific force to use, and before which samples (n, T) to start again."""
        return usable(self._samples, self._unseen, self._dt, *self._paired(gyro, accel))


class FilterpyFilter(PackagedFilter):
    """An extended or an unscented Kalman filter of filterpy for n vehicles."""

    def __init__(
        self, kind: Literal["ekf", "ukf"], rate_hz: float, gyro_noise: float, accel_noise: float
    ) -> None:
        """Make the filter for one vehicle.

        Args:
            kind: Extended or unscented.
            rate_hz: Samples per second.
            gyro_noise: Noise density of the rate [rad/√s].
            accel_noise: Noise density of the measured direction [√s].
        """
        self.kind, dt = kind, 1.0 / rate_hz
        self._process = 0.25 * gyro_noise**2 * dt * np.eye(4)
        self._measurement = accel_noise**2 / dt * np.eye(3)
        super().__init__(rate_hz)

    def sequence(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take (n, T, 3) samples, carrying on from the last; roll and pitch (n, T, 2) [rad]."""
        gyro, accel = self._paired(gyro, accel)
        _, rate, force, unseen = sanitise(self._samples, self._dt, gyro, accel)
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

    def _started(self, quat: Array, known: bool) -> list[ExtendedKalmanFilter | UnscentedKalmanFilter]:
        covariance = 0.25 * (SIGMA_KNOWN if known else SIGMA_UNKNOWN) ** 2 * np.eye(4)
        return [self._filter(q, covariance) for q in quat]

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


@njit(cache=True)
def usable(states, so_far, dt, gyro, accel):
    """Samples to give to VQF, and which of them end a gap longer than it bears.

    Args:
        states: Records (n,) of `SAMPLES`, updated.
        so_far: Variance of what was turned unseen in a gap that lasts (n,) [rad²]; updated.
        dt: Sample period [s].
        gyro: (n, T, 3) [rad/s].
        accel: (n, T, 3) [m/s²].

    Returns:
        Rate and specific force (n, T, 3), as of `sanitise`, and the ends of gaps (n, T).
    """
    rate, _, force, unseen = sanitise(states, dt, gyro, accel)
    lost = np.zeros(gyro.shape[:2], np.bool_)
    for i in range(gyro.shape[0]):
        for t in range(gyro.shape[1]):
            if unseen[i, t] > 0.0:
                so_far[i] += unseen[i, t]
            else:
                lost[i, t] = so_far[i] > LOST * LOST
                so_far[i] = 0.0
    return rate, force, lost


@njit(cache=True, error_model="numpy")
def roll_pitch(quats):
    """Roll and pitch (k, 2) [rad] of quaternions (k, 4); a call costs a fifth of `roll_pitch_from_quat`'s."""
    out = np.empty((quats.shape[0], 2))
    for i in range(quats.shape[0]):
        out[i, 0], out[i, 1], _ = euler_core(quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3])
    return out


def _run(vqf: VQF, rate: Array, force: Array, lost: NDArray[np.bool_]) -> Array:
    """Quaternions (T, 4) of one vehicle's samples (T, 3), starting again where lost (T,)."""
    starts = np.flatnonzero(lost)
    parts = []
    for first, last in zip([0, *starts], [*starts, len(rate)], strict=True):
        if first in starts:
            _start_again(vqf)
        if last > first:
            parts.append(vqf.updateBatch(rate[first:last], force[first:last])["quat6D"])
    return np.concatenate(parts)


def _start_again(vqf: VQF) -> None:
    """Put VQF at its start, with the gyroscope's bias and its covariance as they are."""
    old = vqf.state
    vqf.resetState()
    new = vqf.state
    for key in ("bias", "biasP"):
        new[key] = old[key]
    vqf.state = new


def _start_at(vqf: VQF, quat: Array) -> None:
    """Put VQF at an attitude, its acceleration low-pass in the steady state of a vehicle at rest there."""
    state, coefficients = vqf.state, vqf.coeffs
    b, a = np.asarray(coefficients["accLpB"]), np.asarray(coefficients["accLpA"])
    settled = [VQF.filterInitialState(level, b, a) for level in (0.0, 0.0, GRAVITY)]
    state["gyrQuat"] = quat.tolist()
    state["accLpState"] = np.concatenate(settled).tolist()
    state["lastAccLp"] = [0.0, 0.0, GRAVITY]
    vqf.state = state
