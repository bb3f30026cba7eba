"""Emulated Loihi, all integers: spikes in, spikes out; cores, decay profiles and the limits of the chip."""

from .layers import LoihiLayer, LoihiNetwork

__all__ = ["LoihiLayer", "LoihiNetwork"]
