"""The emulated Loihi chip: integer neurons, cores, decay profiles and limits."""

from .layers import LoihiLayer, LoihiNetwork

__all__ = ["LoihiLayer", "LoihiNetwork"]
