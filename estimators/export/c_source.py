"""Spiking networks as C99 for microcontrollers, bit-identical to the emulated chip.

Estimators and controllers use the same code.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray

from quadsim.config.ranges import FORCE_MAX, RATE_MAX
from quadsim.runs.files import write_whole
from quadsim.runs.fingerprint import ASSETS
from quadsim.vehicle import GRAVITY

from ..control.controller import THRUST_MAX, set_point_gain
from ..loihi.neurons import STATE_ONE
from ..networks.encoder import HOLD, INPUT_MAX, Scaling, input_scaling
from ..networks.layer_parameters import PARAMETERS, complete, of_layer
from ..networks.weights_file import NetworkConfig, Tensors, parameter_count
from ..sanitise import RATE_STEP

Ints = NDArray[np.int64]

ESTIMATOR, CONTROLLER = "att_snn", "snn_control"
"""Names of the files, and prefixes of the C identifiers."""
WORDS = {
    "roll-pitch": {
        "title": "Att-SNN, a spiking network that estimates roll and pitch from an IMU",
        "read": "attitude",
        "and_set_point": "",
        "and_set_points": "",
        "with_set_point": "",
        "unit": "radians",
        "UNIT": "RADIAN",
        "quantity": "roll or pitch in radians",
    },
    "angular-acceleration": {
        "title": "A spiking network that controls the attitude of a quadrotor from set-points, a gyroscope "
        "and an estimate of roll and pitch",
        "read": "action",
        "and_set_point": " and set_point",
        "and_set_points": ", and set-points",
        "with_set_point": ", with level set-points",
        "unit": "rad/s^2",
        "UNIT": "RAD_PER_S2",
        "quantity": "an angular acceleration in rad/s^2",
    },
}
"""Names of the outputs in the templates."""
SECTION = re.compile(r"#if (\w+)\n(.*?)#endif\n", re.DOTALL)
"""Marks of optional parts of the templates."""
BLOCK, BIASED = 16, 128
"""Number of hidden neurons that the C code sums together, and the offset of their weights."""
BYTES = (0, 2, 1, 3)
"""Order of the four neurons whose weights share a word, from the lowest byte on."""


def write_c(folder: str | Path, config: NetworkConfig, tensors: Tensors) -> None:
    """Write `att_snn.h` and `.c`, or `snn_control.h` and `.c` for a controller, to a folder.

    Raises:
        ValueError: The network is not a spiking network for the chip.
    """
    if not config.quantised or config.recurrent_delay != 1:
        raise ValueError("C99 needs quantised weights of att-snn with a recurrent delay of 1")
    name = CONTROLLER if config.controls else ESTIMATOR
    values = {
        "n": name,
        "N": name.upper(),
        **WORDS[config.outputs],
        "encoding": config.encoding,
        "hidden": config.hidden,
        "parameters": parameter_count(tensors),
        "rate": f"{config.rate_hz:g}",
        "inputs": config.n_inputs,
        "outputs": config.n_outputs,
        "units": round(STATE_ONE / config.output_scale),
        "scale": repr(config.output_scale / STATE_ONE),
        **encoder_values(input_scaling(config.inputs)),
        **_set_points(config),
        **_integers(tensors),
    }
    kept = {"CONTROLS": config.controls, "ESTIMATES": not config.controls}
    write_sources(folder, "network", values, SECTION, lambda found: found[2] if kept[found[1]] else "")


def encoder_values(scaling: Scaling) -> dict[str, object]:
    """Return the template values for the encoding of readings."""
    return {
        "input_max": INPUT_MAX,
        "rate_max": RATE_MAX,
        "force_max": FORCE_MAX,
        "rate_step": RATE_STEP,
        "hold": HOLD,
        "offset": braces(scaling.offset),
        "gain": braces(scaling.gain),
    }


def write_sources(
    folder: str | Path,
    template: str,
    values: Mapping[str, object],
    pattern: re.Pattern[str],
    part: Callable[[re.Match[str]], str],
) -> None:
    """Write header and source from templates; `part` replaces each marked place."""
    for end in ("h", "c"):
        text = pattern.sub(part, (ASSETS / "c99" / f"{template}.{end}").read_text(encoding="utf-8"))
        write_whole(Path(folder) / f"{values['n']}.{end}", Template(text).substitute(values))


def _set_points(config: NetworkConfig) -> dict[str, str | float]:
    """Return the template values for set-points and outputs of a controller; none for an estimator."""
    scaling = config.set_point
    if scaling is None:
        return {}
    limits = np.array([scaling.tilt_limit, scaling.tilt_limit, scaling.yaw_rate_limit])
    return {
        "tilt_limit": f"{scaling.tilt_limit:g}",
        "yaw_rate_limit": f"{scaling.yaw_rate_limit:g}",
        "set_point_max": braces(limits),
        "set_point_gain": braces(set_point_gain(scaling)),
        "thrust_max": f"{THRUST_MAX:.1f}",
        "gravity": repr(float(GRAVITY)),
        "bound": repr(scaling.bound),
    }


def _integers(tensors: Tensors) -> dict[str, str]:
    """Return weights and decays in the layout of the C code."""
    integers = {name: value.astype(np.int64) for name, value in complete(tensors).items()}
    found = {name: PARAMETERS[name].kind.in_c(value) for name, value in integers.items()}
    encoding, hidden, outputs = (of_layer(found, layer) for layer in ("encoding", "hidden", "outputs"))
    named = {role: str(value[0]) for role, value in outputs.items() if role != "w_in"}
    named["w_out"] = braces(outputs["w_in"].T)
    for name, role in (("ff", "w_in"), ("rec", "w_rec")):
        rows, ranges = _blocks(hidden.pop(role))
        named[f"w_{name}"], named[f"from_{name}"] = braces(rows, hexadecimal=True), braces(ranges)
    weights = [braces(w, hexadecimal=True) for w in _pairs(encoding.pop("w_in"))]
    encoders = (f"{{{', '.join(map(str, row))}}}" for row in zip(*encoding.values(), weights, strict=True))
    named["encoders"] = "{\n" + ",\n".join(encoders) + "}"
    return named | {"neurons": braces(np.stack([*hidden.values()], 1))}


def _blocks(weights: Ints) -> tuple[Ints, Ints]:
    """Return words of four weights, and each block's first source, end, and row of source 0."""
    sources, count = weights.shape[1], 0
    rows, ranges = [], []
    for block in _padded(weights, BLOCK).reshape(-1, BLOCK, sources):
        sending = np.flatnonzero(block.any(0))
        first, end = (sending[0], sending[-1] + 1) if sending.size else (0, 1)  # C has no empty arrays
        first = min(first, count)  # no row stands before the table
        ranges.append((first, end, count - first))
        rows.append(block[:, first:end].T + BIASED)
        count += end - first
    fours = np.concatenate(rows).reshape(-1, BLOCK // 4, 4)[..., BYTES]
    return (fours << (8 * np.arange(4))).sum(-1), np.array(ranges)


def _pairs(weights: Ints) -> Ints:
    """Pack two 16-bit numbers per word, (rows, ceil(columns / 2))."""
    twos = _padded(weights.T, 2).T.reshape(len(weights), -1, 2) & 0xFFFF
    return twos[..., 0] | twos[..., 1] << 16


def _padded(values: Ints, size: int) -> Ints:
    """Append rows of zeros up to a multiple of `size`."""
    return np.concatenate([values, np.zeros((-len(values) % size, *values.shape[1:]), np.int64)])


def braces(values: NDArray, hexadecimal: bool = False) -> str:
    """Return a C initialiser."""
    if values.ndim > 1:
        return "{\n" + ",\n".join(braces(row, hexadecimal) for row in values) + "}"
    return "{" + ", ".join(f"0x{x:08x}" if hexadecimal else repr(x) for x in values.tolist()) + "}"
