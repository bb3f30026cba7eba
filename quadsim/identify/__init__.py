"""Identification of a vehicle's constants and of an IMU's noise and vibration from flights."""

from .fit import Identified, identify
from .noise import InFlight, noise_in_flight
from .signals import Flight, flights_of

__all__ = ["Flight", "Identified", "InFlight", "flights_of", "identify", "noise_in_flight"]
