"""What the simulator asks of an attitude estimator."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray


class AttitudeEstimator(Protocol):
    """Roll and pitch from a 6-axis IMU, for n vehicles at once, one sample at a time.

    Optional members, looked up by name where they are used:

    - `observe(quat)`: an estimator that is fed the truth; called with quat_WB (n, 4) just before `update`.
    - `sequence(gyro, accel)`: (n, T, 3) twice -> (n, T, 2), the same numbers as T calls of `update`, faster.
    - `restart(ids, roll_pitch=None)`: `reset` for some of the vehicles, the others fly on.
    - `quat` (n, 4), and `reset(quat=...)`: the filter estimates a quaternion quat_WB.
    - `gyro_bias` (n, 3) [rad/s]: the filter estimates the bias of its gyroscope.
    - `skipped` (n,): samples since `reset` that were missing in part or whole and were bridged by prediction.
    """

    rate_hz: float

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Forget everything and start n vehicles.

        Args:
            n: Number of vehicles.
            roll_pitch: Attitude one sample before the first update, (n, 2) [rad]; None where it is not known.
        """
        ...

    def update(self, gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take one sample.

        Args:
            gyro: Body rate, (n, 3) [rad/s].
            accel: Specific force in body axes, (n, 3) [m/s²].

        Returns:
            Roll and pitch at the time of this sample, (n, 2) [rad].
        """
        ...
