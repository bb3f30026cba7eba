"""Att-SNN as a graph of the Neuromorphic Intermediate Representation (NIR, Pedersen et al. 2024).

The importers of Norse 1.1 and snnTorch 1.0 read `Linear` and `CubaLIF` nodes, but not leaky integrators (LI,
CubaLI) or `Scale`. The graph therefore uses only `Linear` and `CubaLIF`. A leaky integrator is represented by
two linear nodes in a loop, x[t] = I[t] + τ x[t−1]. A `CubaLIF` is a differential equation with these Euler
steps of size `STEP`:

    u[t] = (1 − STEP/tau_syn) u[t−1] + I[t],    v[t] = (1 − STEP/tau_mem) v[t−1] + u[t]

The gains (`w_in`, `r`) cancel the factor STEP/tau of the inputs. The encoding layer is a `CubaLIF`. The
current of a hidden neuron is an integrator before a `CubaLIF` whose own u equals its input.

Both tools deliver along a chain within a step and around a loop after one step. The hidden layer is therefore
one step ahead of that on the chip, and the outputs are two steps ahead. snnTorch's importer orders the nodes
by name, and a wrong order would add steps to a loop, so each name starts with a number.

The metadata of each node contains the integers of the chip.
"""

from __future__ import annotations

from pathlib import Path

import nir
import numpy as np
from numpy.typing import NDArray

from quadsim.runs.files import replace

from ..control.controller import set_point_gain
from ..networks.encoder import input_scaling
from ..networks.forward import BIAS_EXP, real_weights
from ..networks.layer_parameters import EXPONENTS, NEURON_CONSTANTS, THRESHOLDS, complete, of_layer
from ..networks.weights_file import NetworkConfig, Tensors

Array = NDArray[np.float64]
STEP = 1e-4
"""Step of the network in the unit of the time constants [s]; snnTorch's importer accepts no other value."""


def write_nir(path: str | Path, config: NetworkConfig, tensors: Tensors) -> None:
    """Write the network from scaled inputs to output potentials, for `nir.read`.

    The inputs are 6 readings; for a controller, roll, pitch and yaw rate of the set-point follow (9). The
    scales are in the metadata.

    Raises:
        ValueError: The network does not have the chip's time convention.
    """
    if config.recurrent_delay != 1:
        raise ValueError("a NIR graph needs weights of att-snn with a recurrent delay of 1")
    values = real_weights(config, tensors)
    whole = complete(tensors) if config.quantised else {}
    real = {name: getattr(values, name) for name in NEURON_CONSTANTS}
    integers = {name: whole[name] for name in NEURON_CONSTANTS if whole}
    hidden, outputs = config.hidden, config.n_outputs

    def weights(name: str) -> nir.Linear:
        w = getattr(values, name)
        exponents = whole.get(EXPONENTS.get(name, ""), np.zeros(len(w), np.int16))
        return _linear(w, {"mantissa": whole[name], "exponent": exponents} if whole else None)

    def decay(layer: str, role: str, size: int) -> nir.Linear:
        tau, metadata = of_layer(real, layer)[role], of_layer(integers, layer)
        return _linear(np.diag(np.broadcast_to(tau, size)), {role: metadata[role]} if whole else None)

    def neurons(layer: str) -> nir.CubaLIF:
        constants = {"vth": np.array(THRESHOLDS[layer])} | of_layer(real, layer)
        metadata = of_layer(integers, layer)
        if layer == "hidden":  # an integrator in front of it has its current
            constants["du"] = np.zeros(hidden)
            metadata.pop("du", None)
        tau_syn, tau_mem = STEP / (1 - constants["du"]), STEP / (1 - constants["dv"])
        return nir.CubaLIF(
            tau_syn=tau_syn,
            tau_mem=tau_mem,
            r=tau_mem / STEP,
            w_in=tau_syn / STEP,
            v_leak=np.zeros_like(tau_mem),
            v_threshold=np.broadcast_to(constants["vth"], tau_mem.shape),
            metadata=metadata,
        )

    layers: dict[str, tuple[nir.NIRNode, tuple[str, ...]]] = {
        "input": (nir.Input({"input": np.array([config.n_inputs])}), ()),
        "w_in": (weights("w_in"), ("input",)),
        "encoding": (neurons("encoding"), ("w_in",)),
        "w_ff": (weights("w_ff"), ("encoding",)),
        "current": (_linear(np.eye(hidden)), ("w_ff", "w_rec", "current_decay")),
        "current_decay": (decay("hidden", "du", hidden), ("current",)),
        "hidden": (neurons("hidden"), ("current",)),
        "w_rec": (weights("w_rec"), ("hidden",)),
        "w_out": (weights("w_out"), ("hidden",)),
        "output_current": (_linear(np.eye(outputs)), ("w_out", "output_current_decay")),
        "output_current_decay": (decay("outputs", "du", outputs), ("output_current",)),
        "output": (_linear(np.eye(outputs)), ("output_current", "output_decay")),
        "output_decay": (decay("outputs", "dv", outputs), ("output",)),
        "finish": (nir.Output({"output": np.array([outputs])}), ("output",)),
    }
    numbered = {name: f"{k:02d}_{name}" for k, name in enumerate(layers)}
    graph = nir.NIRGraph(
        nodes={numbered[name]: node for name, (node, _) in layers.items()},
        edges=[(numbered[source], numbered[name]) for name in layers for source in layers[name][1]],
        metadata=_about(config),
    )
    replace(path, lambda part: nir.write(str(part), graph))


def _linear(weight: Array, metadata: dict[str, NDArray] | None = None) -> nir.Linear:
    return nir.Linear(weight=weight, metadata=metadata or {})


def _about(config: NetworkConfig) -> dict:
    offset, gain = input_scaling(config.inputs)
    about = {
        "dt": STEP,
        "rate_hz": config.rate_hz,
        "input_offset": offset,
        "input_gain_1024": gain,
        "outputs": config.outputs,
        "output_scale": config.output_scale,
    }
    if config.set_point:
        about |= {"set_point_gain_1024": set_point_gain(config.set_point)}
    return about | ({"vth": 128, "bias_exp": BIAS_EXP} if config.quantised else {})
