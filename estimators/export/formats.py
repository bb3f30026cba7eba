"""Export of networks as NIR, C99 or ONNX, and of circuits as C99."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..circuit.file import is_circuit, load_circuit
from ..networks.weights_file import NetworkConfig, load_network

FORMATS = ("nir", "c99", "onnx")
HOLD = {"att-snn": ("nir", "c99"), "att-rnn": ("onnx",), "a circuit": ("c99",)}
"""Formats for each model; NIR and ONNX cannot represent the products of a circuit."""


def export_weights(weights: str | Path, out: str | Path, format: str) -> Path:
    """Write a network in another format.

    Args:
        weights: A file of weights or of a circuit, or a shipped name, such as "att-snn".
        out: The file (nir, onnx) or folder (c99) to write. It must not exist.
        format: "nir" (spiking, HDF5; runs in Norse and snnTorch), "c99" (spiking, header and source) or
            "onnx" (att-rnn).

    Raises:
        FileNotFoundError: The weights do not exist.
        ValueError: The format is unknown or cannot represent the network, or `out` exists.
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
