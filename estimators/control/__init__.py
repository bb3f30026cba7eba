"""Attitude controllers that are networks: everything that runs when one flies."""

from .controller import SpikingController, create_controller

__all__ = ["SpikingController", "create_controller"]
