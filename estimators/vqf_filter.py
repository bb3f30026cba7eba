"""VQF, the versatile quaternion-based filter, from its authors' package: one C++ object per vehicle, 6 axes.

D. Laidig, T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic
disturbance rejection", Information Fusion 91, 2023. Its low-pass starts as a running mean, so with an
unknown initial attitude it takes the inclination of the first specific force at once, and levels out over
`tauAcc`: its own behaviour, kept.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vqf import VQF

from quadsim.rotation import roll_pitch_from_quat
from quadsim.vehicle import GRAVITY

from .filters import Parameter, initial_quat, paired
from .sample import SKIPPED, clean, fresh

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
        self._samples, self.filters = fresh(n), self._started(n, roll_pitch, quat)

    def restart(
        self, ids: ArrayLike, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None
    ) -> None:
        """Start some of the vehicles again, the others fly on; attitudes (len(ids), ·) as in `reset`."""
        rows = np.atleast_1d(np.asarray(ids, dtype=np.intp))
        if rows.size > 0:
            self._samples[rows] = fresh(rows.size)
            for i, each in zip(rows, self._started(rows.size, roll_pitch, quat), strict=True):
                self.filters[i] = each

    def update(self, gyro: Array, accel: Array) -> Array:
        """Take one sample (n, 3) [rad/s], (n, 3) [m/s²]; roll and pitch (n, 2) [rad]."""
        rate, force = self._usable(np.asarray(gyro)[:, None], np.asarray(accel)[:, None])
        for i, each in enumerate(self.filters):
            each.update(rate[i, 0], force[i, 0])
        return roll_pitch_from_quat(self.quat)

    def sequence(self, gyro: Array, accel: Array) -> Array:
        """Take (n, T, 3) samples, carrying on from the last; roll and pitch (n, T, 2) [rad]."""
        rate, force = self._usable(gyro, accel)
        results = [each.updateBatch(rate[i], force[i]) for i, each in enumerate(self.filters)]
        return roll_pitch_from_quat(np.stack([result["quat6D"] for result in results]))

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
        return self._samples[:, SKIPPED].astype(np.int64)

    def _started(self, n: int, roll_pitch: ArrayLike | None, quat: ArrayLike | None) -> list[VQF]:
        attitude, known = initial_quat(n, roll_pitch, quat)
        filters = [VQF(self._dt, **self._options) for _ in range(n)]
        if known:
            for each, q in zip(filters, attitude, strict=True):
                _start_at(each, q)
        return filters

    def _usable(self, gyro: ArrayLike, accel: ArrayLike) -> tuple[Array, Array]:
        gyro, accel = paired(gyro, accel)
        if len(gyro) != len(self.filters):
            raise ValueError(f"gyro holds {len(gyro)} vehicles; reset was for {len(self.filters)}")
        rate, force = np.empty_like(gyro), np.empty_like(accel)
        clean(self._samples, self._dt, gyro, accel, rate, force, False)
        return rate, force


def _start_at(vqf: VQF, quat: Array) -> None:
    """Put VQF at an attitude, its acceleration low-pass in the steady state of a vehicle at rest there."""
    state, coefficients = vqf.state, vqf.coeffs
    b, a = np.asarray(coefficients["accLpB"]), np.asarray(coefficients["accLpA"])
    steady = [VQF.filterInitialState(level, b, a) for level in (0.0, 0.0, GRAVITY)]
    state["gyrQuat"] = quat.tolist()
    state["accLpState"] = np.concatenate(steady).tolist()
    state["lastAccLp"] = [0.0, 0.0, GRAVITY]
    vqf.state = state
