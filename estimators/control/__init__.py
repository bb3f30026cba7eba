"""Spiking networks as attitude controllers."""

from .controller import SpikingController, create_controller

__all__ = ["SpikingController", "create_controller"]
