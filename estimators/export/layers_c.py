"""A chain of layers as C99: header, source and main program, bit-identical to the emulated chip."""

from __future__ import annotations

from pathlib import Path
from string import Template

import numpy as np

from quadsim.runs.files import write_whole
from quadsim.runs.fingerprint import ASSETS

from ..loihi.neurons import VTH_EXP, VTH_MAX
from ..networks.encoder import INPUT_ONE
from .c_source import braces
from .chip_network import ChipNetwork

FILES = {"layers.h": "network.h", "layers.c": "network.c", "layers_main.c": "main.c"}
"""Templates, and the names of the files made from them."""


def write_layers_c(folder: str | Path, network: ChipNetwork) -> None:
    """Write `network.h`, `network.c` and `main.c` to a folder."""
    layers, encoders = network.layers, network.encoders
    sizes = [len(layer.w_in) for layer in layers]
    inputs = layers[0].w_in.shape[1] if encoders is None else len(encoders) - 1
    first = inputs if encoders is None else 0
    starts = np.cumsum([0, *sizes]).tolist()
    tables, synapses = [], []
    for k, layer in enumerate(layers):
        below = 0 if k == 0 else first + starts[k - 1]
        for name, weights, exponents, source in (
            ("IN", layer.w_in, layer.exp_in, below),
            ("REC", layer.w_rec, layer.exp_rec, first + starts[k]),
        ):
            if weights is not None and weights.size:
                name = f"{name}_{k}"
                shape = f"[{weights.shape[1]}][{sizes[k]}]"
                tables.append(f"static const int8_t {name}{shape} = {braces(weights.T // 2)};")
                tables.append(f"static const uint8_t UNIT_{name}[] = {braces(1 << (7 + exponents))};")
                ends = f"{source}, {weights.shape[1]}, {starts[k]}, {sizes[k]}"
                synapses.append(f"{{{ends}, *{name}, UNIT_{name}}},\n")
    values = {
        "inputs": inputs,
        "encoded": 0 if encoders is None else sizes[0],
        "neurons": starts[-1],
        "outputs": sizes[-1],
        "spiking": int((layers[-1].vth < VTH_MAX).any()),
        "input_one": INPUT_ONE,
        "one": repr(network.ones[-1]),
        "tables": "\n".join(tables),
        "synapses": "".join(synapses),
        "du": braces(np.concatenate([layer.du for layer in layers])),
        "dv": braces(np.concatenate([layer.dv for layer in layers])),
        "vth": braces(np.concatenate([layer.vth << VTH_EXP for layer in layers])),
        "bias": braces(np.concatenate([layer.bias_mant << layer.bias_exp for layer in layers])),
        "encoders": "{}" if encoders is None else braces(encoders.T),
    }
    for template, name in FILES.items():
        text = (ASSETS / "c99" / template).read_text(encoding="utf-8")
        write_whole(Path(folder) / name, Template(text).substitute(values))
