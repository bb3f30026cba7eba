"""Att-SNN on the emulated chip: the host drives the encoding layer, the rest is the chip's integers."""

from __future__ import annotations

import numpy as np

from ..loihi.chip import partition
from ..loihi.layers import LoihiLayer
from ..loihi.neurons import VTH_MAX
from .forward import Spiking
from .weights_file import NetworkConfig, Tensors, exponents


class OnLoihi(Spiking):
    """Att-SNN in integers: the encoding current on the host, all that spikes and the outputs on the chip.

    Raises:
        ValueError: The network is not quantised, not in the chip's time convention, or does not fit.
    """

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Place the network on the chip."""
        if config.model != "att-snn" or not config.quantised or config.recurrent_delay != 1:
            raise ValueError("the chip needs quantised weights of att-snn with a recurrent delay of 1")
        super().__init__(config, tensors)
        self.layers = chip_layers(config, tensors)
        self.cores = partition(self.layers)


def chip_layers(config: NetworkConfig, tensors: Tensors) -> list[LoihiLayer]:
    """The populations of a quantised network: encoding, hidden, outputs."""
    w = {name: value.astype(np.int64) for name, value in tensors.items()}
    hidden = LoihiLayer(
        w_in=w["w_ff"],
        w_rec=w["w_rec"],
        du=w["syn1"],
        dv=w["mem1"],
        exp_in=exponents(w, "w_ff"),
        exp_rec=exponents(w, "w_rec"),
    )
    outputs = LoihiLayer(w_in=w["w_out"], du=w["syn2"], dv=w["mem2"], vth=VTH_MAX)
    encoding = LoihiLayer(w_in=np.zeros((config.encoding, 0), np.int64), dv=w["mem0"])
    return [encoding, hidden, outputs]
