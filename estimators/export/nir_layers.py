"""Import of NIR graphs (Pedersen et al. 2024) from other tools as layers of neurons in floats.

NIR defines differential equations. They are integrated by Euler steps with the new current, as in the
importers of Norse and snnTorch:

    u[t] = (1 - dt/tau_syn) u[t-1] + g (W s + b),    g = r (dt/tau_mem) w_in (dt/tau_syn)
    v[t] = (1 - dt/tau_mem) v[t-1] + u[t];           a spike where v > v_threshold, and then v = v_reset

LIF, LI and IF have no current state. Potentials are relative to `v_leak`, because the chip leaks and resets
to 0.

An LI before a neuron is its synapse. A linear node of weight 1 with a diagonal node in a loop around it also
represents an LI, as written by `nir_graph`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import nir
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Nodes = dict[str, Any]
Edges = list[tuple[str, str]]

LINEAR, SPIKING = ("Affine", "Linear", "Scale"), ("IF", "LIF", "CubaLIF")
NEURONS = (*SPIKING, "LI", "CubaLI")
SUPPORTED = ("Input", "Output", "Flatten", *LINEAR, *NEURONS)
ONE_CHAIN = "supported is one chain of layers, each with or without linear connections to itself"
LARGEST_FILE = 1 << 29
"""Largest size of arrays that are read [bytes]; the synapses of a whole chip take less."""
LARGEST_NETWORK = 8192
"""Largest number of inputs and neurons."""


class FloatLayer(NamedTuple):
    """One population of neurons in floats; the weights include the gain of the inputs."""

    name: str  #: of its node
    w_in: Array  #: weights from the layer below, or from the inputs, (out, in)
    w_rec: Array  #: recurrent weights, (out, out)
    bias: Array  #: what enters the current in every step, as all below (out,)
    syn: Array  #: what a step leaves of the current
    mem: Array  #: what it leaves of the potential
    vth: Array  #: thresholds, infinite where nothing spikes


def read_graph(path: str | Path) -> nir.NIRGraph:
    """Read a NIR file.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is not a NIR file or is damaged, or its arrays are too large for a chip.
    """
    import h5py  # which nir brings

    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such NIR file")
    sizes: list[int] = []
    try:
        with h5py.File(path, "r") as file:
            file.visititems(lambda _, each: sizes.append(getattr(each, "nbytes", 0)))
        if sum(sizes) > LARGEST_FILE:  # before an array is read: a small file may declare gigabytes
            raise ValueError(f"{sum(sizes) >> 20} MiB of arrays, at most {LARGEST_FILE >> 20} are read")
        graph = nir.read(path, type_check=False)  # the check refuses the inputs of Norse's files
        return nir.NIRGraph(graph.nodes, graph.edges, metadata=graph.metadata, type_check=False)
    except (
        AssertionError,
        AttributeError,
        LookupError,
        OSError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        wrong = str(error) or type(error).__name__
        raise ValueError(f"{path}: not a NIR graph, or damaged: {wrong}") from error


def layers_of(graph: nir.NIRGraph, dt: float) -> list[FloatLayer]:
    """Convert a graph to layers.

    Args:
        graph: A chain from Input to Output, in which layers may be recurrent.
        dt: Time step, in the unit of the time constants [s].

    Raises:
        ValueError: A node, a connection or a value is not supported; the message names the node.
    """
    for name, node in graph.nodes.items():
        if (kind := type(node).__name__) not in SUPPORTED:
            raise ValueError(f'node "{name}" is a {kind}, supported are {", ".join(SUPPORTED)}')
    nodes, edges = _without_loops(graph, dt)
    chain = _chain(nodes, edges)
    layers: list[FloatLayer] = []
    size = total = int(np.prod(nodes[chain[0][0]].input_type["input"]))
    weight, offset, synapse = None, 0.0, None
    for (name, recurrent), (following, _) in zip(chain, [*chain[1:], chain[0]], strict=True):
        kind = type(nodes[name]).__name__
        if total > LARGEST_NETWORK:
            raise ValueError(f"{total} inputs and neurons, the emulator takes {LARGEST_NETWORK}")
        if kind not in (*LINEAR, *NEURONS):
            continue
        if layers and np.isinf(layers[-1].vth).all():
            raise ValueError(f'node "{layers[-1].name}" sends potentials to "{name}"; the chip sends spikes')
        if kind in LINEAR:
            matrix, bias = _linear(name, nodes[name], size)
            offset = matrix @ (np.zeros(size) + offset) + bias
            weight = matrix if weight is None else matrix @ weight
            size = len(matrix)
            continue
        gain, syn, mem, vth = _constants(name, nodes[name], size, dt)
        if kind == "LI" and type(nodes[following]).__name__ in NEURONS and not np.any(nodes[name].v_leak):
            synapse = gain, mem
            continue
        if synapse is not None:
            if np.any(syn):
                raise ValueError(f'node "{name}" has an LI in front and a synapse; the chip has one')
            gain, syn = gain * synapse[0], synapse[1]
        w_rec = np.zeros((size, size))
        for each in recurrent:
            matrix, bias = _linear(each, nodes[each], size)
            w_rec, offset = w_rec + matrix, offset + bias
        w_in = np.eye(size) if weight is None else weight
        layers.append(
            FloatLayer(name, gain[:, None] * w_in, gain[:, None] * w_rec, gain * offset, syn, mem, vth)
        )
        weight, offset, synapse, total = None, 0.0, None, total + size
    if weight is not None:  # a linear readout: integrators that forget everything in a step
        zero = np.zeros(size)
        layers.append(FloatLayer("readout", weight, np.diag(zero), zero + offset, zero, zero, zero + np.inf))
    if not layers:
        raise ValueError("no neurons from Input to Output")
    return layers


def _without_loops(graph: nir.NIRGraph, dt: float) -> tuple[Nodes, Edges]:
    """Replace each node of weight 1 with a diagonal loop by an LI; return nodes and edges."""
    nodes: Nodes = dict(graph.nodes)
    edges = list(dict.fromkeys(graph.edges))
    for one, decay in list(edges):
        loop = {(one, decay), (decay, one)}
        linear = all(isinstance(nodes.get(each), nir.Linear) for each in (one, decay))
        if not linear or {edge for edge in edges if decay in edge} != loop:
            continue
        left = np.diag(weight := np.asarray(nodes[decay].weight, np.float64))
        if np.array_equal(nodes[one].weight, np.eye(len(left))) and np.array_equal(weight, np.diag(left)):
            nodes[one] = nir.LI(tau=dt / (1.0 - left), r=1.0 / (1.0 - left), v_leak=np.zeros(len(left)))
            del nodes[decay]
            edges = [edge for edge in edges if edge not in loop]
    return nodes, edges


def _chain(nodes: Nodes, edges: Edges) -> list[tuple[str, list[str]]]:
    """Return the nodes from Input to Output, each with its recurrent linear nodes."""
    kinds = {name: type(node).__name__ for name, node in nodes.items()}
    ends = [[name for name, kind in kinds.items() if kind == end] for end in ("Input", "Output")]
    if [len(each) for each in ends] != [1, 1]:
        raise ValueError(f"{len(ends[0])} nodes Input and {len(ends[1])} Output, there should be one of each")
    chain: list[tuple[str, list[str]]] = []
    name, left = ends[0][0], set(edges)
    while kinds[name] != "Output":
        after = [end for start, end in edges if start == name]
        entry = chain[-1][0] if chain and kinds[chain[-1][0]] == "LI" else name
        loops = {each: {(name, each), (each, entry)} for each in after if kinds[each] in LINEAR}
        loops = {each: loop for each, loop in loops.items() if {e for e in edges if each in e} == loop}
        recurrent = list(loops) if kinds[name] in SPIKING else []
        left = left.difference(*(loops[each] for each in recurrent))
        forward = [each for each in after if each not in recurrent]
        if len(forward) != 1 or (name, forward[0]) not in left:
            raise ValueError(f'node "{name}" leads to {len(forward)} others or back; {ONE_CHAIN}')
        left.remove((name, forward[0]))
        chain.append((name, recurrent))
        name = forward[0]
    if left:
        raise ValueError('node "{}" leads to "{}"; {}'.format(*min(left), ONE_CHAIN))
    return [*chain, (name, [])]


def _linear(name: str, node: Any, size: int) -> tuple[Array, Array]:
    """Return weights (out, size) and biases (out,) of a linear node."""
    if isinstance(node, nir.Scale):
        return np.diag(_vector(name, "scale", node.scale, size)), np.zeros(size)
    weight = np.asarray(node.weight, np.float64)
    if weight.ndim != 2 or weight.shape[1] != size:
        raise ValueError(f'node "{name}": weight of shape {weight.shape} for {size} inputs')
    _vector(name, "weight", weight, weight.size)
    return weight, _vector(name, "bias", getattr(node, "bias", 0.0), len(weight))


def _constants(name: str, node: Any, size: int, dt: float) -> tuple[Array, Array, Array, Array]:
    """Return input gain, decay factors of current and potential, and thresholds, (size,) each."""

    def of(field: str) -> Array:
        return _vector(name, field, getattr(node, field, 0.0), size)

    def share(field: str) -> Array:
        tau = of(field)
        if np.any(wrong := tau < dt / (1 + 1e-6)):  # time constants of Norse and snnTorch are float32
            raise ValueError(
                f'node "{name}": {field} = {tau[wrong][0]:.4g} s is below the step, dt = {dt:g} s'
            )
        return np.minimum(dt / tau, 1.0)

    gain, syn, mem = of("r") * dt, np.zeros(size), np.ones(size)
    if not isinstance(node, nir.IF):
        leak = share("tau_mem" if hasattr(node, "tau_mem") else "tau")
        gain, mem = of("r") * leak, 1.0 - leak
    if hasattr(node, "tau_syn"):
        syn = 1.0 - share("tau_syn")
        gain = gain * of("w_in") * (1.0 - syn)
    if not hasattr(node, "v_threshold"):
        return gain, syn, mem, np.full(size, np.inf)
    rest, reset, vth = of("v_leak"), of("v_reset"), of("v_threshold")
    if np.any(reset != rest):
        raise ValueError(f'node "{name}": v_reset is not v_leak, to which the chip resets')
    if np.any(vth <= rest):
        raise ValueError(f'node "{name}": v_threshold is not above v_leak')
    return gain, syn, mem, vth - rest


def _vector(name: str, field: str, value: object, size: int) -> Array:
    """Return a parameter of a node, given as one number or `size` numbers, as a vector (size,)."""
    x = np.asarray(value, np.float64).ravel()
    if x.size not in (1, size):
        raise ValueError(f'node "{name}": {field} has {x.size} values, should have 1 or {size}')
    if not np.isfinite(x).all():
        raise ValueError(f'node "{name}": {field} has values that are not finite')
    return np.broadcast_to(x, size)
