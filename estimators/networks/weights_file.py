"""Weights files: safetensors with the configuration of the network in the metadata."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue, ValidationError, model_validator
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from quadsim.config.ranges import Between, ForceVector, SampleRate
from quadsim.config.toml import Strict, describe
from quadsim.runs.files import write_whole
from quadsim.runs.fingerprint import ASSETS

from .layer_parameters import EXPONENTS, MATRICES, PARAMETERS, Weights

Tensors = dict[str, NDArray[Any]]
Shapes = dict[str, tuple[int, ...]]
Config = TypeVar("Config", bound=Strict)
END = ".safetensors"
FORMAT = "3"
"""Version of the file format, in the metadata; files of quadsim 0.1 have none."""


ForceRange = Annotated[float, Between(1e-3, 1e4, "m/s²")]
Neurons = Annotated[int, Between(1, 4096)]
OutputScale = Annotated[float, Between(1e-6, 1e3, "rad")]
READINGS, SET_POINTS = 6, 3
"""Number of readings of every network, gyroscope first, and of set-points of a controller: roll, pitch, yaw
rate."""
CONTROLLER = "control-"
"""Prefix of the names of shipped controllers."""
CIRCUIT = "circuit-1"
"""Format of files that contain a circuit (`estimators.circuit.file`)."""
KINDS = {FORMAT: "a network of layers", CIRCUIT: "a circuit"}


class InputScaling(Strict):
    """Scaling of the inputs of a network: (reading - offset) / range, gyroscope first."""

    gyro: Annotated[float, Between(1e-3, 1e4, "rad/s")] = 2.5
    """Body rate that gives an input of 1.0 [rad/s]."""
    accel: tuple[ForceRange, ForceRange, ForceRange] = (1.0, 1.0, 4.0)
    """Specific force minus offset that gives an input of 1.0 [m/s²]."""
    accel_offset: ForceVector = (0.0, 0.0, 9.81)
    """Specific force that gives an input of 0 [m/s²]."""


PAPER_SCALING = InputScaling(gyro=4.2, accel=(16.8, 16.8, 16.8), accel_offset=(0.0, 0.0, 0.0))


class SetPointScaling(Strict):
    """Scaling of a controller's set-points: clipped to the limit and divided by the range."""

    tilt: Annotated[float, Between(1e-3, 10.0, "rad")] = 0.5
    """Roll or pitch that gives an input of 1.0 [rad]."""
    yaw_rate: Annotated[float, Between(1e-3, 100.0, "rad/s")] = 1.5
    """Yaw rate that gives an input of 1.0 [rad/s]."""
    tilt_limit: Annotated[float, Between(1e-3, 3.14, "rad")] = 1.05
    """Largest roll or pitch [rad]; larger set-points are clipped."""
    yaw_rate_limit: Annotated[float, Between(1e-3, 100.0, "rad/s")] = 3.0
    """Largest yaw rate [rad/s]; larger set-points are clipped."""
    bound: Annotated[float, Between(1e-3, 1e4, "rad/s²")] = 150.0
    """Largest commanded angular acceleration about any axis [rad/s²]."""


class Layers(Strict):
    """The layers of a network, trained or to be trained."""

    encoding: Neurons = 100
    """Neurons of the encoding layer (att-rnn: units of the first GRU)."""
    hidden: Neurons = 100
    """Neurons of the recurrent layer (att-rnn: units of the second GRU)."""
    quantised: bool = True
    """Whether weights, decays and states are whole numbers in the ranges of the chip (att-snn)."""
    recurrent_delay: Literal[1, 2] = 1
    """Delay of the recurrent connections in steps; 1 is the chip's convention, 2 the paper's (att-snn)."""
    outputs: Literal["roll-pitch", "angular-acceleration"] = "roll-pitch"
    """Outputs: roll and pitch [rad] of an attitude estimator, or angular acceleration in body axes [rad/s²]
    of a controller."""


class NetworkConfig(Layers):
    """Configuration of a network, and the origin of its weights."""

    model: Literal["att-snn", "att-rnn"]
    rate_hz: SampleRate = 200.0
    """Samples per second of the training."""
    inputs: InputScaling = InputScaling()
    output_scale: OutputScale = 1.0
    """Output for a potential of 1.0 [rad or rad/s²]."""
    set_point: SetPointScaling | None = None
    """Scaling and limits of a controller, whose input is the specific force at rest at the estimated attitude
    instead of the accelerometer's reading; None for an attitude estimator."""
    training: dict[str, JsonValue] = Field(default_factory=dict)
    """Training: data, seed, epochs, commit, validation error."""

    @model_validator(mode="after")
    def _one_task(self) -> NetworkConfig:
        if (self.outputs == "angular-acceleration") != (self.set_point is not None):
            raise ValueError("outputs: angular-acceleration and set_point go together, those of a controller")
        if self.controls and self.model != "att-snn":
            raise ValueError(f"model: {self.model}; a controller is a spiking network, att-snn")
        return self

    @property
    def controls(self) -> bool:
        """Whether the network is a controller and not an attitude estimator."""
        return self.set_point is not None

    @property
    def n_inputs(self) -> int:
        """Number of inputs: 6 readings and, for a controller, 3 set-points."""
        return READINGS + SET_POINTS * self.controls

    @property
    def n_outputs(self) -> int:
        """Number of outputs, 2 or 3."""
        return 2 if self.outputs == "roll-pitch" else 3

    @property
    def whole(self) -> bool:
        """Whether the tensors are whole numbers in the ranges of the chip."""
        return self.model == "att-snn" and self.quantised


def tensor_shapes(config: NetworkConfig) -> Shapes:
    """Return names and shapes of the tensors of a network."""
    h0, h1, out = config.encoding, config.hidden, config.n_outputs
    if config.model == "att-snn":
        sizes = {"inputs": config.n_inputs, "encoding": h0, "hidden": h1, "outputs": out, "one": 1}
        return {name: tuple(sizes[axis] for axis in PARAMETERS[name].axes) for name in Weights._fields}
    shapes: Shapes = {"out.weight": (out, h1), "out.bias": (out,)}
    for layer, (inputs, units) in enumerate(((6, h0), (h0, h1))):
        shapes |= {f"gru.weight_ih_l{layer}": (3 * units, inputs), f"gru.bias_ih_l{layer}": (3 * units,)}
        shapes |= {f"gru.weight_hh_l{layer}": (3 * units, units), f"gru.bias_hh_l{layer}": (3 * units,)}
    return shapes


def parameter_count(tensors: Mapping[str, NDArray[Any]]) -> int:
    """Count the parameters of a network: non-zero weights, time constants and biases."""
    return sum(
        int(np.count_nonzero(value)) if name in MATRICES else value.size
        for name, value in tensors.items()
        if name not in EXPONENTS.values()
    )


def save_network(path: str | Path, config: NetworkConfig, tensors: Mapping[str, NDArray[Any]]) -> None:
    """Write a network.

    Args:
        path: File to write.
        config: Configuration of the network.
        tensors: Weights. For a spiking network, float weights and time constants if `quantised` is false;
            otherwise the int16 numbers that `layer_parameters` describes.

    Raises:
        ValueError: The tensors do not fit the configuration.
    """
    check_shapes(path, {name: value.shape for name, value in tensors.items()}, *_shapes(config))
    _check_values(path, config, tensors)
    plain = {name: np.ascontiguousarray(value) for name, value in tensors.items()}
    unused = None if config.controls else {"set_point"}
    metadata = {"format": FORMAT, "config": config.model_dump_json(exclude=unused)}
    write_whole(path, ordered(save(plain, metadata=metadata)))


def ordered(content: bytes) -> bytes:
    """Sort the keys in the header of a safetensors file, whose order is random."""
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    text = json.dumps(header, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
    return content[:8] + text.ljust(size) + content[8 + size :]


class Network(NamedTuple):
    """Content of a weights file."""

    config: NetworkConfig
    tensors: Tensors


def load_network(path: str | Path) -> Network:
    """Read a network written by `save_network`.

    Args:
        path: The file, or the shipped name of an estimator's or a controller's weights, such as
            "att-snn-paper".

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is not a weights file, or a tensor has the wrong shape or type.
    """
    shipped = [*shipped_names(), *shipped_controllers()]
    path = ASSETS / "weights" / f"{path}{END}" if str(path) in shipped else Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such weights file; shipped: {', '.join(shipped)}")
    config, tensors = read_tensors(path, NetworkConfig, FORMAT, lambda config, _: _shapes(config))
    _check_values(path, config, tensors)
    return Network(config, tensors)


def read_tensors(
    path: Path, kind: type[Config], format: str, shapes: Callable[[Config, Shapes], tuple[Shapes, Shapes]]
) -> tuple[Config, Tensors]:
    """Read configuration and tensors of a file; `shapes` returns the shapes for `check_shapes`.

    Raises:
        ValueError: The file has another format or other tensors.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            config = _config_of(path, file.metadata() or {}, kind, format)
            declared = {name: tuple(file.get_slice(name).get_shape()) for name in file.keys()}  # noqa: SIM118
            # before a number is read: a small file may declare gigabytes
            check_shapes(path, declared, *shapes(config, declared))
            return config, {name: file.get_tensor(name) for name in declared}
    except (SafetensorError, TypeError) as error:
        raise ValueError(f"{path}: not a safetensors file, or of unknown numbers ({error})") from error


def attitude_network(path: str | Path) -> Network:
    """Read the weights of an attitude estimator with `load_network`.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: As in `load_network`, or the weights are those of a controller.
    """
    network = load_network(path)
    if network.config.controls:
        raise ValueError(f"{path}: a controller, not an attitude estimator; fly it as the controller")
    return network


def shipped_names() -> list[str]:
    """Return the names of shipped weights of attitude estimators."""
    return [name for name in _shipped() if not name.startswith(CONTROLLER)]


def shipped_controllers() -> list[str]:
    """Return the names of shipped weights of controllers."""
    return [name for name in _shipped() if name.startswith(CONTROLLER)]


def _shipped() -> list[str]:
    return sorted(each.stem for each in (ASSETS / "weights").glob(f"*{END}"))


def _config_of(path: Path, metadata: Mapping[str, str], kind: type[Config], format: str) -> Config:
    if (found := metadata.get("format")) in KINDS and found != format:
        raise ValueError(f"{path}: {KINDS[found]}, not {KINDS[format]}")
    if found != format:
        of = "of quadsim 0.1" if found is None else f"of format {found!r}"
        raise ValueError(f"{path}: weights {of}, this version of quadsim reads {format!r}; train them again")
    try:
        return kind.model_validate_json(metadata.get("config", ""))
    except ValidationError as error:
        wrong = describe(error, kind)
        raise ValueError(f"{path}: weights of another version of quadsim: {wrong}") from error


def _shapes(config: NetworkConfig) -> tuple[Shapes, Shapes]:
    """Return the shapes of required and of optional tensors."""
    return tensor_shapes(config), {name: (config.hidden,) for name in EXPONENTS.values() if config.whole}


def check_shapes(path: str | Path, found: Shapes, needed: Shapes, optional: Shapes) -> None:
    """Check names and shapes of the tensors in a file.

    Raises:
        ValueError: A tensor is missing, unknown or has the wrong shape; the message names the first one.
    """
    wanted = needed | optional
    if missing := sorted(set(needed) - set(found)):
        raise ValueError(f"{path}: tensor {missing[0]} is missing")
    for name, shape in found.items():
        if name not in wanted:
            raise ValueError(f"{path}: unknown tensor {name}, there are {', '.join(wanted)}")
        if shape != wanted[name]:
            raise ValueError(f"{path}: tensor {name} has shape {shape}, should be {wanted[name]}")


def _check_values(path: str | Path, config: NetworkConfig, tensors: Mapping[str, NDArray[Any]]) -> None:
    number = "int16" if config.whole else "float"
    if wrong := [name for name, value in tensors.items() if not value.dtype.name.startswith(number)]:
        raise ValueError(f"{path}: tensor {wrong[0]} is {tensors[wrong[0]].dtype}, should be {number}")
    for name, value in tensors.items():
        if not np.all(np.isfinite(value)):
            raise ValueError(f"{path}: tensor {name} has values that are not finite")
        if not config.whole:
            continue
        low, high = PARAMETERS[name].kind.low, PARAMETERS[name].kind.high
        if value.min() < low or value.max() > high:
            span = f"{value.min()}...{value.max()}"
            raise ValueError(f"{path}: tensor {name} spans {span}, allowed {low}...{high}")
        if name in MATRICES and np.any(value % 2):
            raise ValueError(f"{path}: tensor {name} has odd mantissas, only even ones exist")
