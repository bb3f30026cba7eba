"""Att-SNN as a graph of the Neuromorphic Intermediate Representation (NIR, Pedersen et al. 2024).

NIR's neurons are differential equations; a simulator that integrates them with Euler steps of `dt` finds the
network's own recursion again, with τ = 1 − dt / tau and gains that undo the dt / tau on the inputs:

    u[t] = (1 − dt/tau_syn) u[t−1] + I[t],    v[t] = (1 − dt/tau_mem) v[t−1] + u[t]

The integers of the chip stand in the metadata of each node. NIR delivers along a chain within a step and
around a loop after one, so the hidden layer is one step ahead of the chip's, and the outputs two.

A neuron of NIR (CubaLIF) has one current. With after-spike currents a hidden neuron is therefore two leaky
integrators, `synapse` and `after`, in front of a plain LIF neuron, `hidden`.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import nir
import numpy as np
from numpy.typing import NDArray

from quadsim.runs.files import replace

from ..control.weights import Reads
from ..networks.encoder import INPUT_ONE, input_scaling
from ..networks.forward import BIAS_EXP, THRESHOLD, Weights
from ..networks.network import real_weights
from ..networks.weights_file import NetworkConfig, Tensors, exponents

LAYERS = {"encoding": ("syn0", "mem0"), "hidden": ("syn1", "mem1"), "output": ("syn2", "mem2")}
CONNECTIONS = {
    "w_in": ("input", "encoding"),
    "w_ff": ("encoding", "hidden"),
    "w_rec": ("hidden", "hidden"),
    "w_out": ("hidden", "output"),
}


def nir_graph(
    config: NetworkConfig, tensors: Tensors, dt: float | None = None, reads: Reads = "imu"
) -> nir.NIRGraph:
    """The network between its scaled inputs and its output potentials; scales are in its metadata.

    Inputs are the readings (6), of a controller roll, pitch and yaw rate of the set-point after them (9).

    Args:
        config: How the network is run.
        tensors: Its weights.
        dt: Step to write the time constants for [s]; None: the network's own.
        reads: What a controller has beside the set-points; an attitude takes the place of the accelerometer.

    Raises:
        ValueError: Not an Att-SNN in the chip's time convention.
    """
    if config.model != "att-snn" or config.recurrent_delay != 1:
        raise ValueError("a NIR graph needs weights of att-snn with a recurrent delay of 1")
    step = dt or 1.0 / (config.rate_hz * config.steps_per_sample)
    values = real_weights(config, tensors)
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": np.array([config.n_inputs])})}
    edges = []
    for name, (source, target) in CONNECTIONS.items():
        if config.after_spike and target == "hidden":
            target = "synapse"
        whole = _integers(config, mantissa=tensors[name], exponent=exponents(tensors, name))
        nodes[name] = nir.Linear(weight=getattr(values, name), metadata=whole)
        edges += [(source, name), (name, target)]
    sizes = (config.encoding, config.hidden, config.n_outputs)
    for size, (layer, names) in zip(sizes, LAYERS.items(), strict=True):
        syn, mem = (np.broadcast_to(getattr(values, name), size) for name in names)
        decays = dict(zip(("du", "dv"), (tensors[name] for name in names), strict=True))
        nodes[layer] = _neurons(layer, syn, mem, step, _integers(config, **decays))
    if config.after_spike:
        nodes |= _with_after_spike(config, tensors, values, step)
        loop = ("hidden", "w_after", "after", "hidden")
        edges += [("synapse", "hidden"), *pairwise(loop)]
    nodes["finish"] = nir.Output({"output": np.array([config.n_outputs])})
    edges.append(("output", "finish"))
    return nir.NIRGraph(nodes=nodes, edges=edges, metadata=_about(config, step, reads))


def write_nir(path: str | Path, config: NetworkConfig, tensors: Tensors, reads: Reads = "imu") -> None:
    """Write the graph as an HDF5 file that `nir.read` reads."""
    graph = nir_graph(config, tensors, reads=reads)
    replace(path, lambda part: nir.write(str(part), graph))


def _neurons(
    layer: str, syn: NDArray[np.float64], mem: NDArray[np.float64], dt: float, metadata: dict
) -> nir.NIRNode:
    tau_syn, tau_mem = dt / (1 - syn), dt / (1 - mem)
    common = {"tau_syn": tau_syn, "tau_mem": tau_mem, "r": tau_mem / dt, "v_leak": np.zeros(len(syn))}
    common |= {"w_in": tau_syn / dt, "metadata": metadata}
    if layer == "output":
        return nir.CubaLI(**common)
    return nir.CubaLIF(v_threshold=np.full(len(syn), THRESHOLD), **common)


def _with_after_spike(
    config: NetworkConfig, tensors: Tensors, values: Weights[NDArray], dt: float
) -> dict[str, nir.NIRNode]:
    """The hidden layer and the currents in front of it."""

    def leaky(tau: NDArray, decay: str, name: str) -> dict:
        constant = dt / (1 - tau)
        whole = _integers(config, **{name: tensors[decay]})
        return {"tau": constant, "r": constant / dt, "v_leak": np.zeros(len(tau)), "metadata": whole}

    own = _integers(config, mantissa=tensors["w_after"][:, 0], exponent=exponents(tensors, "w_after"))
    threshold = np.full(config.hidden, THRESHOLD)
    return {
        "synapse": nir.LI(**leaky(values.syn1, "syn1", "du")),
        "w_after": nir.Scale(scale=values.w_after[:, 0], metadata=own),
        "after": nir.LI(**leaky(values.syn_after, "syn_after", "du")),
        "hidden": nir.LIF(v_threshold=threshold, **leaky(values.mem1, "mem1", "dv")),
    }


def _integers(config: NetworkConfig, **values: NDArray) -> dict[str, NDArray]:
    return values if config.quantised else {}


def _about(config: NetworkConfig, dt: float, reads: Reads) -> dict:
    offset, gain = input_scaling(config.inputs)
    integers = {"vth": 128, "bias_exp": BIAS_EXP} if config.quantised else {}
    asked = config.set_point
    scales = (
        {}
        if asked is None
        else {
            "set_point_gain_1024": INPUT_ONE / np.array([asked.tilt, asked.tilt, asked.yaw_rate]),
            "reads": reads,
        }
    )
    return {
        "dt": dt,
        "steps_per_sample": config.steps_per_sample,
        "input_offset": offset,
        "input_gain_1024": gain,
        "outputs": config.outputs,
        "output_scale": config.output_scale,
        **scales,
        **integers,
    }
