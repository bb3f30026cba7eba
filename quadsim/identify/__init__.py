"""Identification of a vehicle's constants and of an IMU's noise and vibration from flights."""

from .fit import Identified, identify
from .noise import Spectrum, spectrum
from .signals import Flight, flights_of

__all__ = ["Flight", "Identified", "Spectrum", "flights_of", "identify", "spectrum"]
