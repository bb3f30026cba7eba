"""Att-SNN as C99 for a microcontroller: one header, one source, the emulator's numbers to the last bit."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray

from quadsim.config.ranges import FORCE_MAX, RATE_MAX
from quadsim.runs.files import write_whole

from ..loihi.neurons import DECAY_ONE, STATE_ONE
from ..networks.encoder import INPUT_MAX, input_scaling
from ..networks.forward import MATRICES, TIME_CONSTANTS
from ..networks.weights_file import EXPONENTS, NetworkConfig, Tensors, exponents, parameters

WORDS = {
    "roll-pitch": {
        "name": "roll_pitch",
        "task": "roll and pitch",
        "what": "Roll and pitch [rad]",
        "unit": "radians",
        "UNIT": "RADIAN",
        "quantity": "roll or pitch in radians",
        "level": "",
    },
    "up": {
        "name": "up",
        "task": "the world's up",
        "what": "The world's up in body axes, not of length 1: roll is atan2(up[1], up[2]),\n"
        " * pitch atan2(-up[0], sqrt(up[1] * up[1] + up[2] * up[2])),",
        "unit": "parts of a unit vector",
        "UNIT": "ONE",
        "quantity": "a component of up less that of a level attitude, (0, 0, 1)",
        "level": " + (k == 2)",
    },
}
"""What the templates call the outputs."""
AFTER_SPIKE_ONLY = re.compile(r"#if AFTER_SPIKE\n(.*?)#endif\n", re.DOTALL)
"""Parts of the templates for networks with after-spike currents."""


def c_files(config: NetworkConfig, tensors: Tensors) -> dict[str, str]:
    """The two files by name: `att_snn.h` and `att_snn.c`.

    Args:
        config: How the network is run.
        tensors: Its weights, the chip's integers.

    Raises:
        ValueError: Not an Att-SNN for the chip.
    """
    if config.model != "att-snn" or not config.quantised or config.recurrent_delay != 1:
        raise ValueError("C99 needs quantised weights of att-snn with a recurrent delay of 1")
    offset, gain = input_scaling(config.inputs)
    integers = {name: value.astype(np.int64) for name, value in tensors.items()}
    halves = {name: integers[name] // 2 for name in MATRICES if name in integers}
    by_source = {name: value.squeeze(1) if name == "w_after" else value.T for name, value in halves.items()}
    decays = {name: DECAY_ONE - integers[name] for name in TIME_CONSTANTS if name in integers}
    shifts = {exp: 7 + exponents(integers, name) for name, exp in EXPONENTS.items() if name in integers}
    arrays = {name: _braces(value) for name, value in (by_source | decays | shifts).items()}
    arrays |= {name: str(decays[name][0]) for name in ("syn2", "mem2")}
    values = {
        "encoding": config.encoding,
        "hidden": config.hidden,
        "parameters": parameters(tensors),
        "rate": f"{config.rate_hz:g}",
        **WORDS[config.outputs],
        "outputs": config.n_outputs,
        "units": round(STATE_ONE / config.output_scale),
        "scale": repr(config.output_scale / STATE_ONE),
        "steps": config.steps_per_sample,
        "input_max": INPUT_MAX,
        "rate_max": RATE_MAX,
        "force_max": FORCE_MAX,
        "offset": _braces(offset),
        "gain": _braces(gain),
        **arrays,
    }
    folder = files("assets") / "c99"
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in ("att_snn.h", "att_snn.c")}
    kept = r"\1" if config.after_spike else ""
    return {
        name: Template(AFTER_SPIKE_ONLY.sub(kept, text)).substitute(values) for name, text in texts.items()
    }


def write_c(folder: str | Path, config: NetworkConfig, tensors: Tensors) -> None:
    """Write both files into a folder, which is made where it is missing."""
    texts = c_files(config, tensors)
    for name, text in texts.items():
        write_whole(Path(folder) / name, text)


def _braces(values: NDArray) -> str:
    """An initialiser; numbers as C and Python both read them."""
    if values.ndim > 1:
        return "{\n" + ",\n".join(_braces(row) for row in values) + "}"
    return "{" + ", ".join(repr(value) for value in values.tolist()) + "}"
