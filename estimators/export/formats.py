"""Trained networks in the formats of other tools: NIR, C99, ONNX; circuits in C99."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..circuit.file import is_circuit, load_circuit
from ..networks.weights_file import NetworkConfig, load_network

FORMATS = ("nir", "c99", "onnx")
HOLD = {"att-snn": ("nir", "c99"), "att-rnn": ("onnx",), "a circuit": ("c99",)}
"""Formats that can hold a network of a model; NIR and ONNX cannot hold the products of a circuit."""


def export_weights(weights: str | Path, out: str | Path, format: str) -> Path:
    """Write a network in another format.

    Args:
        weights: A file of weights or of a circuit, or the name of one that ships, such as "att-snn".
        out: The file (nir, onnx) or folder (c99) to write; must not exist.
        format: "nir" (spiking, HDF5; runs in Norse and snnTorch), "c99" (spiking, header and source) or
            "onnx" (att-rnn).

    Raises:
        FileNotFoundError: No such weights.
        ValueError: An unknown format, one that cannot hold this network, or `out` exists.
    """
    circuit = is_circuit(weights)
    config, values = load_circuit(weights) if circuit else load_network(weights)
    kind = config.model if isinstance(config, NetworkConfig) else "a circuit"
    if format not in HOLD[kind]:
        known = "" if format in FORMATS else f'unknown format "{format}"; '
        raise ValueError(f"{known}weights of {kind} are exported as {' or '.join(HOLD[kind])}")
    if Path(out).exists():
        raise ValueError(f"{out}: exists already, choose another name")
    write: Callable[..., None]
    if circuit:
        from .circuit_c import write_circuit_c as write
    elif format == "nir":
        from .nir_graph import write_nir as write
    elif format == "onnx":
        from .onnx_graph import write_onnx as write
    else:
        from .c_source import write_c as write
    write(out, config, values)
    return Path(out)
