"""The true attitude as an estimator: the reference that a closed loop is compared with."""

from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import OtherSensors
from quadsim.rotation import roll_pitch_from_quat

from .filters.algorithm import initial_quat

Array = NDArray[np.float64]


class Truth:
    """Roll and pitch of the quaternion that `observe` was last given; no sensor is used."""

    def __init__(self, rate_hz: float) -> None:
        """Make it for one vehicle; the sample rate has no effect."""
        self.rate_hz = rate_hz
        self.reset()

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None) -> None:
        """Start n vehicles: level, or at a known attitude, roll_pitch (n, 2) [rad] or quat_WB (n, 4)."""
        self.quat = initial_quat(n, roll_pitch, quat)[0]

    def restart(
        self, ids: ArrayLike, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None
    ) -> None:
        """Start some of the vehicles again; attitudes (len(ids), ·) as in `reset`."""
        rows = np.atleast_1d(np.asarray(ids, dtype=np.intp))
        if rows.size > 0:
            self.quat[rows] = initial_quat(rows.size, roll_pitch, quat)[0]

    def observe(self, quat: Array) -> None:
        """Take the true quat_WB (n, 4); call it just before `update`."""
        self.quat = np.array(quat, dtype=np.float64)

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Roll and pitch of the last quaternion observed, (n, 2) [rad]."""
        return roll_pitch_from_quat(self.quat)
