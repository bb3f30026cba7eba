"""VQF, the versatile quaternion-based filter, from its authors' package: one C++ object per vehicle, 6 axes.

D. Laidig, T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic
disturbance rejection", Information Fusion 91, 2023. Its low-pass starts as a running mean, so with an
unknown initial attitude it takes the inclination of the first specific force at once, and levels out over
`tauAcc`, which is its own behaviour. After a gap in which the vehicle may have turned by more than `LOST` it
starts again like that, with the bias that it had estimated.
"""

import math
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vqf import VQF

from quadsim.estimator import OtherSensors
from quadsim.rotation import euler_core
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from .algorithm import Parameter, initial_quat, paired
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


class VqfFilter:
    """VQF for n vehicles."""

    def __init__(self, rate_hz: float, values: dict[str, float]) -> None:
        """Make the filter for one vehicle; `reset` changes their number.

        Args:
            rate_hz: Samples per second.
            values: The package's parameters; switches are 0 or 1.
        """
        self.rate_hz, self.values, self._dt = rate_hz, dict(values), 1.0 / rate_hz
        self._options: dict[str, Any] = values | {key: bool(values[key]) for key in SWITCHES}
        self.reset()

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None) -> None:
        """Start n vehicles: VQF's own start, or at roll_pitch (n, 2) [rad] or quat_WB (n, 4)."""
        self._samples, self.filters = initial_states(n), self._started(n, roll_pitch, quat)
        self._unseen = np.zeros(n)

    def restart(
        self, ids: ArrayLike, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None
    ) -> None:
        """Start some of the vehicles again, the others fly on; attitudes (len(ids), ·) as in `reset`."""
        rows = np.atleast_1d(np.asarray(ids, dtype=np.intp))
        if rows.size > 0:
            self._samples[rows], self._unseen[rows] = initial_states(rows.size), 0.0
            for i, each in zip(rows, self._started(rows.size, roll_pitch, quat), strict=True):
                self.filters[i] = each

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
        rate, force, lost = self._sanitised(gyro, accel)
        quats = [_run(each, *sample) for each, *sample in zip(self.filters, rate, force, lost, strict=True)]
        return np.stack([roll_pitch(quat) for quat in quats])

    @property
    def quat(self) -> Array:
        """Estimated quat_WB (n, 4)."""
        return np.array([each.getQuat6D() for each in self.filters])

    @property
    def gyro_bias(self) -> Array:
        """Estimated gyroscope bias (n, 3) [rad/s]."""
        return np.array([each.getBiasEstimate()[0] for each in self.filters])

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Samples since reset that were missing in part or whole, (n,)."""
        return self._samples["skipped"].astype(np.int64)

    def __getstate__(self) -> dict[str, Any]:
        """For copies and pickles: the package's objects have neither, but give their state."""
        return vars(self) | {"filters": [each.state for each in self.filters]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Undo `__getstate__`."""
        vars(self).update(
            state | {"filters": self._made(state["_dt"], state["_options"], len(state["filters"]))}
        )
        for each, its in zip(self.filters, state["filters"], strict=True):
            each.state = its

    @staticmethod
    def _made(dt: float, options: dict[str, Any], n: int) -> list[VQF]:
        return [VQF(dt, **options) for _ in range(n)]

    def _started(self, n: int, roll_pitch: ArrayLike | None, quat: ArrayLike | None) -> list[VQF]:
        attitude, known = initial_quat(n, roll_pitch, quat)
        filters = self._made(self._dt, self._options, n)
        if known:
            for each, q in zip(filters, attitude, strict=True):
                _start_at(each, q)
        return filters

    def _sanitised(self, gyro: ArrayLike, accel: ArrayLike) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Rate and specific force to use, and before which samples (n, T) to start again."""
        gyro, accel = paired(gyro, accel)
        if len(gyro) != len(self.filters):
            raise ValueError(f"gyro holds {len(gyro)} vehicles; reset was for {len(self.filters)}")
        return usable(self._samples, self._unseen, self._dt, gyro, accel)


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
    rate, force, unseen = sanitise(states, dt, gyro, accel, False)
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
