"""A spiking network for another sample rate: the same neurons in continuous time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.networks.forward import TIME_CONSTANTS
from estimators.networks.network import real_weights
from estimators.networks.weights_file import NetworkConfig, Tensors
from quadsim.config.ranges import SAMPLE_RATE


def rescaled(config: NetworkConfig, tensors: Tensors, rate_hz: float) -> tuple[NetworkConfig, Tensors]:
    """The network with time constants and weights for another sample rate, in floats.

    With k steps in place of one, every decay becomes τ^(1/k). The current of a spike sums to w / (1 − τ_syn).
    For the same sum, weights are multiplied by (1 − τ_syn^(1/k)) / (1 − τ_syn). Inputs act in every step, so
    their weights are divided by k as well.

    The delay of a connection and the reset then take less time: the network is the same only where spikes are
    rare.

    Raises:
        ValueError: Not a spiking network, or a bad rate.
    """
    if config.model != "att-snn":
        raise ValueError(f"{config.model} has no time constants to rescale, att-snn has")
    SAMPLE_RATE.of("rate_hz", rate_hz)
    k = rate_hz / config.rate_hz
    old = real_weights(config, tensors)._asdict()
    old |= {name: np.clip(old[name], 0.0, 4095 / 4096) for name in TIME_CONSTANTS}
    new = {name: old[name] ** (1 / k) for name in TIME_CONSTANTS}

    def area(name: str) -> NDArray[np.float64]:
        return ((1 - new[name]) / (1 - old[name]))[:, None]

    new["w_in"] = old["w_in"] * area("syn0") / k
    new["w_ff"] = old["w_ff"] * area("syn1")
    new["w_rec"] = old["w_rec"] * area("syn1")
    new["w_out"] = old["w_out"] * area("syn2")
    if config.after_spike:
        new["w_after"] = old["w_after"] * area("syn_after")
    changed = config.model_copy(update={"rate_hz": rate_hz, "quantised": False})
    return changed, {name: value.astype(np.float32) for name, value in new.items() if name in tensors}
