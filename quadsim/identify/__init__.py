"""Identification of a vehicle's constants from flights."""

from .fit import Identified, identify
from .signals import Flight, signals_of

__all__ = ["Flight", "Identified", "identify", "signals_of"]
