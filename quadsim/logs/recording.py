"""What a log holds before it is resampled, and how its frames become ours (body FLU, world z up)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..rotation import swap_enu_flu_ned_frd, swap_enu_ned, swap_flu_frd

Array = NDArray[np.float64]
AxesConvention = Literal["flu", "frd"]
"""Body forward-left-up in a world with z up (ROS), or forward-right-down in north-east-down (PX4)."""
TruthAxes = Literal["body", "imu"]
"""A true attitude is of the body, whatever the IMU's mounting, or of the IMU's own axes (an estimate by the
sensor or the autopilot, a dataset whose body frame is the IMU's)."""

IN_BODY_AXES = ("mag",)
"""Sensors beside the IMU that measure a vector in its axes."""


class Track(NamedTuple):
    """Readings of a sensor beside the IMU, on its own stamps."""

    time: Array
    """(K,) [s]."""
    values: Array
    """(K, ·)."""


@dataclass(frozen=True)
class Recording:
    """One log as it was recorded, on its own stamps."""

    name: str
    format: str
    time: Array
    """Stamps of the IMU (T,) [s]."""
    gyro: Array
    """(T, 3) [rad/s]."""
    accel: Array
    """Specific force (T, 3) [m/s²]."""
    truth: str = "none"
    """What was taken for the true attitude."""
    truth_time: Array | None = None
    """Stamps of the attitude (M,) [s]."""
    quat: Array | None = None
    """quat_WB (M, 4); NaN where the recording says that it does not hold."""
    truth_axes: TruthAxes = "body"
    """Axes whose attitude the truth is."""
    position: Array | None = None
    """In the world, on the stamps of the attitude (M, 3) [m]."""
    marked: NDArray[np.bool_] | None = None
    """Samples of the attitude (M,) that the recording marks for scoring; None: all."""
    path: str = ""
    """The file, for what a command is to be given."""
    notes: tuple[str, ...] = ()
    """What the reader decided, in sentences for people."""
    sensors: Mapping[str, Track] = field(default_factory=dict)
    """Sensors beside the IMU, by their name and in their unit in `quadsim.estimator.Readings`."""

    def with_vectors(self, body_from_log: Array) -> Mapping[str, Track]:
        """The sensors, their vectors rotated by a matrix (3, 3) from the log's axes."""
        return {
            name: Track(track.time, track.values @ body_from_log.T) if name in IN_BODY_AXES else track
            for name, track in self.sensors.items()
        }


def from_frd(log: Recording) -> Recording:
    """A log in FRD body axes and an NED world, in ours."""
    return replace(
        log,
        gyro=swap_flu_frd(log.gyro),
        accel=swap_flu_frd(log.accel),
        quat=None if log.quat is None else swap_enu_flu_ned_frd(log.quat),
        position=None if log.position is None else swap_enu_ned(log.position),
        sensors=log.with_vectors(swap_flu_frd(np.eye(3))),
        notes=(*log.notes, "FRD body axes in an NED world turned into FLU axes in a world with z up"),
    )


def table(name: str, columns: Sequence[ArrayLike]) -> Array:
    """Columns of a log as (T, len(columns)) numbers.

    Raises:
        ValueError: The columns differ in length.
    """
    values = [np.asarray(column, np.float64).ravel() for column in columns]
    if len({value.size for value in values}) != 1:
        raise ValueError(f"{name}: {len(values)} columns of one length are required")
    return np.stack(values, axis=1)
