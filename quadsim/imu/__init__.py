"""The IMU: noisy and biased readings from the true motion of a body."""

from .spec import ImuSpec, load_imu
from .stream import ImuStream, simulate_imu

__all__ = ["ImuSpec", "ImuStream", "load_imu", "simulate_imu"]
