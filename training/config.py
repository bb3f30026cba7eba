"""Everything that can be chosen about a training run, and the presets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ValidationError, model_validator

from estimators.networks.symmetry import is_symmetric
from estimators.networks.weights_file import (
    PAPER_SCALING,
    InputScaling,
    Neurons,
    OutputScale,
    StepsPerSample,
    load_network,
)
from quadsim.config.ranges import Between, Share
from quadsim.config.toml import Strict, describe, merged

from .augment import Augmentation

Number = Annotated[int, Between(1, 1_000_000)]
Step = Annotated[float, Between(1e-6, 1e6)]


class TrainConfig(Strict):
    """A training run; the defaults are the paper's recipe."""

    model: Literal["att-snn", "att-rnn"] = "att-snn"
    """Spiking network, or its non-spiking twin."""
    data: tuple[str, ...]
    """Datasets to train on."""
    validation: tuple[str, ...] = ()
    """Datasets to choose the best epoch by; none: a part of `data`, 70/20/10 by flight."""
    folds: Annotated[int, Between(0, 1000)] = 0
    """Parts into which the flights of `data` are dealt, one of them held out as a test; 0: none is."""
    fold: Annotated[int, Between(0, 999)] = 0
    """The part that is held out, counted from 0."""
    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    """Of the initial weights, the split, the windows and the sensor errors."""
    preset: Literal["paper", "best", "robust", "tune"] = "paper"
    """What the other values started from."""

    encoding: Neurons = 100
    """Neurons of the encoding layer."""
    hidden: Neurons = 100
    """Neurons of the recurrent layer."""
    quantised: bool = True
    """Train the network that the chip will run, weights, decays and states rounded (att-snn)."""
    symmetric: bool = False
    """Share the weights that quarter turns and mirror images of the body map onto each other (att-snn)."""
    recurrent_delay: Literal[1, 2] = 1
    """1: the chip's time convention; 2: the paper's equations (att-snn)."""
    steps_per_sample: StepsPerSample = 1
    """Network steps for each IMU sample (att-snn)."""
    inputs: InputScaling = PAPER_SCALING
    """Scaling of the six inputs."""
    output_scale: OutputScale = 1.0
    """Radians for an output potential of 1.0 (att-snn)."""
    start: Literal["random", "solved"] = "random"
    """Random weights of unit scale, or a leaky integrator solved by ridge regression (att-snn)."""

    init: str = ""
    """Weights to go on from, in place of `start`: a file or a shipped name; shape and scaling are theirs."""
    revive: Share = 0.0
    """Share of the epochs, from the first, that begin with new inputs for hidden neurons that never or always
    spike (att-snn)."""
    parameters: Annotated[int, Between(0, 10**8)] = 0
    """Most connections and time constants in the end: training begins with every connection and takes away
    those that matter least (att-snn); 0: all stay."""
    thinning: tuple[Share, Share] = (0.25, 0.7)
    """Shares of the epochs between which connections are taken away."""
    train_decays: bool = True
    """Whether the time constants are trained too (att-snn)."""

    optimiser_lr: Annotated[float, Between(1e-9, 10.0)] = 0.005
    """Learning rate of Adam."""
    layer_steps: tuple[Step, Step, Step] = (1.0, 1.0, 1.0)
    """Its factors for the encoding, the hidden and the output weights (att-snn)."""
    adam_beta2: Annotated[float, Between(1e-3, 1.0 - 1e-6)] = 0.999
    """Decay of Adam's second moment."""
    decay: Literal["none", "cosine"] = "none"
    """Learning rate over the epochs: constant, or half a cosine down to a hundredth."""
    clip: Annotated[float, Between(0.0, 1e6)] = 0.0
    """Largest norm of the gradient; 0: no limit."""
    lookahead_k: Number = 6
    """Steps of the fast weights for one of the slow."""
    lookahead_alpha: Annotated[float, Between(1e-3, 1.0)] = 0.5
    """How far the slow weights follow."""

    epochs: Number = 500
    """Most epochs."""
    batches: Number = 15
    """Updates in an epoch."""
    batch_size: Number = 40
    """Windows in a batch."""
    window_s: Annotated[float, Between(0.01, 3600.0, "s")] = 10.0
    """Length of a window [s]."""
    windows_per_stream: Number = 1
    """Most windows that follow one another with the state carried over (truncated backpropagation)."""
    stop_early: bool = True
    """Stop by the paper's rules: 20-epoch average above 110 % of its lowest, or the lowest 50 epochs old."""
    augmentation: Augmentation = Augmentation()
    """Sensor errors and symmetries, drawn anew for every window or stream."""
    knee: Annotated[float, Between(0.0, 10.0, "rad")] = 0.0
    """Error beyond which it counts in proportion, not by its square: what no network could have known, as
    right after an unknown start, then decides less [rad]; 0: all count by their square."""
    rate_cost: Annotated[float, Between(0.0, 1e6)] = 0.0
    """Weight of the spike rates above their targets [rad² per spike, neuron and step]."""
    rate_targets: tuple[Share, Share] = (0.1, 0.1)
    """Spikes per neuron and step that cost nothing, encoding and hidden layer."""
    threads: Annotated[int, Between(1, 1024)] = 1
    """Threads that share a batch; the result depends on their number in the last digits only."""

    @model_validator(mode="after")
    def _fits(self) -> TrainConfig:
        constants = 2 * (self.encoding + self.hidden) + 2
        if self.model == "att-snn" and 0 < self.parameters <= constants:
            raise ValueError(f"parameters: {self.parameters}, but time constants alone are {constants}")
        if not 0 <= self.thinning[0] < self.thinning[1] <= 1:
            raise ValueError(f"thinning: {self.thinning}, should be two rising shares in 0...1")
        if self.thinned and self.revive > self.thinning[0]:
            raise ValueError(
                f"revive: {self.revive}, but connections are taken away from {self.thinning[0]} on; "
                "give a smaller revive, or parameters=0 to keep them all"
            )
        return self

    @property
    def whole(self) -> int:
        """Parameters of Att-SNN with every connection."""
        h0, h1 = self.encoding, self.hidden
        return 6 * h0 + h0 * h1 + h1 * h1 + 2 * h1 + 2 * (h0 + h1) + 2

    @property
    def thinned(self) -> bool:
        """Whether the network begins with more parameters than it may keep."""
        return self.model == "att-snn" and 0 < self.parameters < self.whole


PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    "best": {
        "inputs": InputScaling(),
        "encoding": 300,
        "hidden": 300,
        "parameters": 21202,
        "symmetric": True,
        "revive": 0.25,
        "output_scale": 1 / 256,
        "start": "solved",
        "optimiser_lr": 0.07,
        "layer_steps": (1.0, 0.3, 0.1),
        "adam_beta2": 0.99,
        "decay": "cosine",
        "clip": 1.0,
        "epochs": 100,
        "batches": 600,
        "batch_size": 4,
        "window_s": 5.0,
        "windows_per_stream": 20,
        "stop_early": False,
        "knee": 0.01,
        "augmentation": Augmentation(gyro_bias=0.0088, accel_bias=0.209, yaw_symmetry=True),
        "rate_cost": 0.03,
        "rate_targets": (0.06, 0.13),
    },
}
"""What each preset changes."""

ROBUST = Augmentation(
    gyro_bias=0.0044,
    accel_bias=0.05,
    yaw_symmetry=True,
    gyro_bias_max=0.0873,
    accel_bias_max=0.5,
    scale_max=0.02,
    mounting_max_deg=5.0,
    noise_factor_max=6.0,
    vibration=(0.5, 3.0),
    vibration_share=0.6,
    low_pass_hz=(15.0, 90.0),
    delay_max_s=0.01,
    carried=0.05,
)
"""Sensors that nobody has calibrated, on vehicles that vibrate."""

PRESETS["robust"] = PRESETS["best"] | {"epochs": 75, "knee": 0.0, "augmentation": ROBUST}

PRESETS["tune"] = PRESETS["best"] | {
    "optimiser_lr": 0.005,
    "epochs": 15,
    "batches": 20,
    "batch_size": 40,
    "window_s": 2.5,
    "windows_per_stream": 4,
    "rate_cost": 0.003,
    "rate_targets": (0.2, 0.4),
    "augmentation": Augmentation(gyro_noise=0.0, accel_noise=0.0, accel_bias=0.0),
    "symmetric": False,  # a user's own sensor is never mounted quite straight
}
"""Go on from weights on a user's own logs, whose errors are real: nothing is added."""

LIKE_THE_PAPER = {"encoding": 100, "hidden": 100, "parameters": 0, "batches": 30, "batch_size": 40}

RNN: dict[str, dict[str, Any]] = {
    "best": LIKE_THE_PAPER | {"optimiser_lr": 0.003, "epochs": 100},
    "robust": LIKE_THE_PAPER | {"optimiser_lr": 0.003},
    "tune": LIKE_THE_PAPER | {"optimiser_lr": 0.002, "batches": 20},
}
"""What the presets change further for att-rnn."""


TABLES = ("inputs", "augmentation")
"""Fields that are tables; a choice changes the keys that it names."""

KEPT = ("encoding", "hidden", "quantised", "recurrent_delay", "steps_per_sample", "output_scale")
"""What a run that goes on from weights takes over from them."""


def make_config(preset: str = "paper", **choices: Any) -> TrainConfig:
    """A configuration from a preset and what differs from it.

    Raises:
        ValueError: One line: an unknown preset or field, or a value out of range.
    """
    if preset not in PRESETS:
        raise ValueError(f"no preset {preset!r}, there are {', '.join(PRESETS)}")
    values = PRESETS[preset] | (RNN.get(preset, {}) if choices.get("model") == "att-rnn" else {})
    for name in ("data", "validation"):
        if isinstance(choices.get(name), str | Path):
            choices[name] = (str(choices[name]),)
        elif isinstance(choices.get(name), list | tuple):
            choices[name] = tuple(str(path) for path in choices[name])
    if choices.get("init"):
        values = values | _of_weights(choices, values)
    elif preset == "tune":
        raise ValueError("preset tune goes on from weights: give init, a shipped name or a file")
    try:
        defaults = {name: field.default for name, field in TrainConfig.model_fields.items() if name in TABLES}
        config = TrainConfig.model_validate(merged(defaults | values, choices) | {"preset": preset})
    except ValidationError as error:
        raise ValueError(f"training: {describe(error, TrainConfig)}") from error
    paths = [Path(path).resolve() for path in (*config.data, *config.validation)]
    if len(set(paths)) < len(paths):
        raise ValueError("data and validation: a dataset is given twice, its flights would count twice")
    return config


def _of_weights(choices: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    """What a run takes over from the weights it goes on from."""
    init = choices["init"] = str(choices["init"])
    network, tensors = load_network(init)
    kept = {name: getattr(network, name) for name in KEPT}
    for name, value in kept.items():
        if choices.get(name, value) != value:
            raise ValueError(f"{name}: the weights of init have {value}, it cannot be {choices[name]}")
    shared = is_symmetric(tensors)
    if choices.get("symmetric") and not shared:
        raise ValueError(f"symmetric: {init} does not share its weights, give symmetric=false")
    return {
        "inputs": network.inputs,
        "symmetric": values.get("symmetric", False) and shared,
        "revive": 0.0,
        **kept,
    }
