"""The cascade's levels of attitude and body rate as an attitude controller, which knows no trajectory."""

import numpy as np
from numpy.typing import NDArray

from quadsim.control.cascade import Controller, follow_attitude
from quadsim.control.records import MEASURED
from quadsim.runs.compiled import njit
from quadsim.vehicle import Vehicle

Array = NDArray[np.float64]


class Cascade:
    """See `quadsim.control.attitude_controller.AttitudeController`."""

    def __init__(self, rate_hz: float, vehicle: Vehicle) -> None:
        self._made = vehicle, rate_hz

    def reset(self, n: int) -> None:
        """Start n vehicles."""
        vehicle, rate_hz = self._made
        self.records = Controller(vehicle, n, rate_hz).records
        self.measured = np.zeros(n, MEASURED)

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array) -> Array:
        """Angular acceleration [rad/s²] and thrust per mass [m/s²], (n, 4)."""
        self.measured["gyro"], self.measured["roll_pitch"] = gyro, roll_pitch
        _follow_all(self.measured, set_point, self.records)
        return np.concatenate([self.records["ang_acc_cmd"], set_point[:, 3:]], axis=1)


@njit
def _follow_all(measured, set_points, records):
    for i in range(records.shape[0]):
        follow_attitude(measured[i], set_points[i], records[i])
