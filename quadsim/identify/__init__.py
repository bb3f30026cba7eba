"""Identification of a vehicle's constants from flights."""

from .fit import Identified, identify
from .signals import Flight, flights_of

__all__ = ["Flight", "Identified", "flights_of", "identify"]
