"""Trained networks in the formats of other tools: NIR, C99, ONNX; circuits in C99."""

from __future__ import annotations

from pathlib import Path

from ..circuit.file import is_circuit, load_circuit
from ..networks.weights_file import load_network

FORMATS = ("nir", "c99", "onnx")
HOLD = {"att-snn": ("nir", "c99"), "att-rnn": ("onnx",)}
"""Formats that can hold a network of a model."""


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
    if is_circuit(weights):
        return _export_circuit(weights, out, format)
    config, tensors = load_network(weights)
    if format not in HOLD[config.model]:
        known = "" if format in FORMATS else f'unknown format "{format}"; '
        raise ValueError(
            f"{known}weights of {config.model} are exported as {' or '.join(HOLD[config.model])}"
        )
    out = _free(out)
    if format == "nir":
        from .nir_graph import write_nir as write
    elif format == "onnx":
        from .onnx_graph import write_onnx as write
    else:
        from .c_source import write_c as write
    write(out, config, tensors)
    return out


def _export_circuit(weights: str | Path, out: str | Path, format: str) -> Path:
    if format != "c99":
        known = "" if format in FORMATS else f'unknown format "{format}"; '
        raise ValueError(
            f"{weights}: {known}a circuit is no chain of layers; "
            "NIR and ONNX cannot hold its products; use c99"
        )
    from .circuit_c import write_circuit_c

    out = _free(out)
    write_circuit_c(out, *load_circuit(weights))
    return out


def _free(out: str | Path) -> Path:
    if Path(out).exists():
        raise ValueError(f"{out}: exists already, choose another name")
    return Path(out)
