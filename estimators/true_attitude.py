"""The true attitude as an estimator, a reference for flights in closed loop."""

import numpy as np
from numpy.typing import NDArray

from quadsim.rotation import roll_pitch_from_quat

from .filters.driver import BatchedFilter

Array = NDArray[np.float64]


class Truth(BatchedFilter):
    """Returns roll and pitch of the quaternion last given to `observe`; no sensor is used."""

    @property
    def quat(self) -> Array:
        """Last true quat_WB (n, 4)."""
        return self.state

    def observe(self, quat: Array) -> None:
        """Store the true quat_WB (n, 4); call this just before `update`."""
        self.state = np.array(quat, dtype=np.float64)

    def _started(self, quat: Array, known: bool) -> Array:
        return quat

    def _run(self, gyro: Array, accel: Array, rotors: Array) -> Array:
        return np.tile(roll_pitch_from_quat(self.state)[:, None], (1, gyro.shape[1], 1))
