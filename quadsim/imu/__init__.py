"""The IMU: the true motion of a body goes in, noisy and biased readings come out."""

from .spec import ImuSpec, load_imu
from .stream import ImuStream, simulate_imu

__all__ = ["ImuSpec", "ImuStream", "load_imu", "simulate_imu"]
