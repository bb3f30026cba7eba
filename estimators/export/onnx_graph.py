"""GRU networks as ONNX graphs, from raw readings to roll and pitch, with the state as input and output."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray

from quadsim.runs.files import write_whole

from ..networks.encoder import INPUT_MAX, INPUT_ONE, input_scaling
from ..networks.weights_file import NetworkConfig, Tensors

GRAPH = """
<ir_version: 9, opset_import: ["" : 17]>
att_rnn (float[T, n, 3] gyro, float[T, n, 3] accel, float[1, n, {h0}] h0, float[1, n, {h1}] h1)
=> (float[T, n, 2] roll_pitch, float[1, n, {h0}] h0_next, float[1, n, {h1}] h1_next)
{{
    readings = Concat <axis = 2> (gyro, accel)
    centred = Sub (readings, offset)
    scaled = Mul (centred, gain)
    rounded = Round (scaled)
    integers = Clip (rounded, floor, limit)
    x = Div (integers, one)
    directions0, h0_next = GRU <hidden_size = {h0}, linear_before_reset = 1> (x, w0, r0, b0, "", h0)
    y0 = Squeeze (directions0, axis)
    directions1, h1_next = GRU <hidden_size = {h1}, linear_before_reset = 1> (y0, w1, r1, b1, "", h1)
    y1 = Squeeze (directions1, axis)
    product = MatMul (y1, w_out)
    roll_pitch = Add (product, b_out)
}}
"""
"""The graph in ONNX's text syntax."""


def write_onnx(path: str | Path, config: NetworkConfig, tensors: Tensors) -> None:
    """Write the graph from `gyro`, `accel` (T, n, 3), `h0`, `h1` (1, n, units) to `roll_pitch` (T, n, 2).

    The outputs `h0_next`, `h1_next` are the states after the last sample; the initial states are zero.
    Missing samples are not bridged, so all readings must be finite.
    """
    offset, gain = input_scaling(config.inputs)
    constants = {
        "offset": offset,
        "gain": gain,
        "limit": INPUT_MAX,
        "floor": -INPUT_MAX,
        "one": INPUT_ONE,
        **_gru(tensors, 0),
        **_gru(tensors, 1),
        "w_out": tensors["out.weight"].T * config.output_scale,
        "b_out": tensors["out.bias"] * config.output_scale,
    }
    model = onnx.parser.parse_model(GRAPH.format(h0=config.encoding, h1=config.hidden))
    arrays = {name: np.asarray(value, np.float32) for name, value in constants.items()}
    arrays["axis"] = np.array([1])
    model.graph.initializer.extend(onnx.numpy_helper.from_array(each, name) for name, each in arrays.items())
    onnx.checker.check_model(model, full_check=True)
    write_whole(path, model.SerializeToString())


def _gru(tensors: Tensors, layer: int) -> dict[str, NDArray]:
    """Return W, R and B in the gate order of ONNX, z, r, n; PyTorch's order is r, z, n."""

    def gates(kind: str) -> NDArray:
        r, z, n = np.split(tensors[f"gru.{kind}_l{layer}"], 3)
        return np.concatenate([z, r, n])

    bias = np.concatenate([gates("bias_ih"), gates("bias_hh")])
    parts = {"w": gates("weight_ih"), "r": gates("weight_hh"), "b": bias}
    return {f"{name}{layer}": each[None] for name, each in parts.items()}
