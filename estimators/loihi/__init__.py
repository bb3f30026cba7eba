"""Emulated Loihi, all integers: spikes in, spikes out; cores, decay profiles and the limits of the chip."""

from .neurons import LoihiLayer, LoihiNetwork

__all__ = ["LoihiLayer", "LoihiNetwork"]
