"""Att-RNN as an ONNX graph, from raw readings to roll and pitch or up, with its state in and out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from quadsim.runs.files import write_whole

from ..networks.encoder import INPUT_MAX, INPUT_ONE, input_scaling
from ..networks.weights_file import LEVEL_UP, NetworkConfig, Tensors

OPSET = 17


def onnx_graph(config: NetworkConfig, tensors: Tensors) -> onnx.ModelProto:
    """The network: `gyro` and `accel` (T, n, 3), `h0` and `h1` (1, n, units) in, `roll_pitch` (T, n, 2) out.

    A network that estimates up has `up` (T, n, 3) in place of `roll_pitch`, not scaled to length 1.
    `h0_next`, `h1_next` are the states after the last sample, zero before the first. There is no bridge for
    missing samples: all readings have to be finite.

    Raises:
        ValueError: Not an Att-RNN.
    """
    if config.model != "att-rnn":
        raise ValueError(f"ONNX needs weights of att-rnn, these are of {config.model}")
    offset, gain = input_scaling(config.inputs)
    output = config.outputs.replace("-", "_")
    level = LEVEL_UP if config.outputs == "up" else 0.0
    constants = {
        "offset": offset, "gain": gain, "limit": np.array(INPUT_MAX), "floor": np.array(-INPUT_MAX),
        "one": np.array(INPUT_ONE), "w_out": tensors["out.weight"].T * config.output_scale,
        "b_out": tensors["out.bias"] * config.output_scale + level, "axis": np.array([1]),
    }  # fmt: skip
    nodes = [
        helper.make_node("Concat", ["gyro", "accel"], ["readings"], axis=2),
        helper.make_node("Sub", ["readings", "offset"], ["centred"]),
        helper.make_node("Mul", ["centred", "gain"], ["scaled"]),
        helper.make_node("Round", ["scaled"], ["rounded"]),
        helper.make_node("Clip", ["rounded", "floor", "limit"], ["integers"]),
        helper.make_node("Div", ["integers", "one"], ["x"]),
    ]
    below = "x"
    for k, units in enumerate((config.encoding, config.hidden)):
        w, r, b = (f"{name}{k}" for name in "wrb")
        constants |= dict(zip((w, r, b), _gru(tensors, k, units), strict=True))
        nodes += [
            helper.make_node(
                "GRU", [below, w, r, b, "", f"h{k}"], [f"directions{k}", f"h{k}_next"],
                hidden_size=units, linear_before_reset=1,
            ),
            helper.make_node("Squeeze", [f"directions{k}", "axis"], [f"y{k}"]),
        ]  # fmt: skip
        below = f"y{k}"
    nodes += [
        helper.make_node("MatMul", [below, "w_out"], ["product"]),
        helper.make_node("Add", ["product", "b_out"], [output]),
    ]
    states = [(f"h{k}", [1, "n", units]) for k, units in enumerate((config.encoding, config.hidden))]
    graph = helper.make_graph(
        nodes,
        "att-rnn",
        [
            _floats(name, shape)
            for name, shape in (("gyro", ["T", "n", 3]), ("accel", ["T", "n", 3]), *states)
        ],
        [
            _floats(output, ["T", "n", config.n_outputs]),
            *(_floats(f"{name}_next", shape) for name, shape in states),
        ],
        [_constant(name, value) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=9)
    onnx.checker.check_model(model, full_check=True)
    return model


def write_onnx(path: str | Path, config: NetworkConfig, tensors: Tensors) -> None:
    """Write the graph."""
    write_whole(path, onnx_graph(config, tensors).SerializeToString())


def _gru(tensors: Tensors, layer: int, units: int) -> list[NDArray]:
    """W, R and B of ONNX, whose gates are z, r, n where PyTorch's are r, z, n."""

    def gates(kind: str) -> NDArray:
        r, z, n = np.split(tensors[f"gru.{kind}_l{layer}"], 3)
        return np.concatenate([z, r, n])

    bias = np.concatenate([gates("bias_ih"), gates("bias_hh")])
    return [each[None] for each in (gates("weight_ih"), gates("weight_hh"), bias)]


def _floats(name: str, shape: list[int | str]) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)


def _constant(name: str, value: NDArray) -> onnx.TensorProto:
    kind = np.int64 if name == "axis" else np.float32
    return numpy_helper.from_array(np.asarray(value, kind), name)
