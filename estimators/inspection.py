"""The inner life of a spiking network: what its neurons do, and which of them matter."""

from __future__ import annotations

from pathlib import Path

from .networks import OnLoihi
from .profiles import share_profiles
from .weights_file import load_network, shipped_network


def load_spiking(weights: str | Path | None = None, profiles: int | None = None) -> tuple[str, OnLoihi]:
    """A network on the chip, with fewer decay profiles where asked, and what to call it.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not an Att-SNN for the chip, or it does not fit.
    """
    config, tensors = shipped_network("att-snn") if weights is None else load_network(weights)
    if config.model != "att-snn":
        raise ValueError(f"{weights}: weights of {config.model}, should be of att-snn")
    if profiles is not None:
        tensors = share_profiles(tensors, profiles)
    return "att-snn" if weights is None else str(weights), OnLoihi(config, tensors)
