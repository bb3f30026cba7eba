"""What can be chosen about a training run; the presets are the files of `assets/presets`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import ValidationError, model_validator

from estimators.loihi.layers import WEIGHT_EXP_MIN
from estimators.networks.weights_file import (
    PAPER_SCALING,
    InputScaling,
    Neurons,
    Outputs,
    SetPointScaling,
)
from quadsim.config.ranges import Between, Share
from quadsim.config.toml import Strict, describe, load_toml, merged
from quadsim.held_out import unreserved

from .augment import Augmentation

Number = Annotated[int, Between(1, 1_000_000)]
Window = Annotated[float, Between(0.01, 3600.0, "s")]
Scale = Annotated[float, Between(1e-3, 1e4, "rad/s²")]
CONTROL: Outputs = "angular-acceleration"
"""Outputs of a controller."""


class Optimisation(NamedTuple):
    """How an optimiser's parameters and steps are chosen."""

    logits: bool
    """Whether parameters are logits of τ and weights over the root mean square of their row; else, as in the
    paper's published code, 1 - τ, and weights over 1 - τ_mem (att-snn)."""
    layer_steps: tuple[float, float, float]
    """Factors of the learning rate for the encoding, the hidden and the output weights (att-snn)."""
    adam_beta2: float
    """Decay of Adam's second moment."""
    cosine: bool
    """Whether the learning rate falls over the epochs, by half a cosine down to a hundredth."""
    clip: float
    """Largest norm of the gradient."""
    stop_early: bool
    """Whether the paper's rules stop a run, see `training.optim.finished`."""


OPTIMISATIONS = {
    "paper": Optimisation(False, (1.0, 1.0, 1.0), 0.999, False, 5.0, True),
    "layered": Optimisation(True, (1.0, 0.3, 0.1), 0.99, True, 1.0, False),
}


class ControlSettings(Strict):
    """Flights that a controller learns from: a teacher's, then its own, which the teacher labels."""

    recipe: str = "control"
    """Flights: a shipped recipe or a TOML file. Its vehicle and IMU are the controller's."""
    set_point: SetPointScaling = SetPointScaling()
    """Scaling and limits of the set-points, and the bound of the outputs."""
    error_scale: tuple[Scale, Scale, Scale] = (10.0, 10.0, 2.0)
    """Errors about roll, pitch and yaw that weigh the same in the loss [rad/s²]."""
    flights: Number = 24
    """Flights by the teacher, which the first round learns from."""
    flight_s: Annotated[float, Between(0.01, 60.0, "s")] = 16.0
    """Length of a flight [s]."""
    rounds: Annotated[int, Between(0, 100)] = 11
    """Further rounds, in each of which the student flies too and the teacher labels its flights (DAgger, Ross
    et al. 2011)."""
    round_flights: Number = 40
    """Flights that each of them adds."""
    teacher_share: Share = 0.3
    """Share of the time at which the teacher flies in the first of them, to the power k in the k-th."""
    validation_flights: Number = 24
    """Flights by the student alone after each epoch, to choose the best by."""


class TrainingRecipe(Strict):
    """How a network is trained: what a preset may set. The defaults are the paper's recipe."""

    encoding: Neurons = 100
    """Neurons of the encoding layer."""
    hidden: Neurons = 100
    """Neurons of the recurrent layer."""
    quantised: bool = True
    """Train the network that the chip will run, weights, decays and states rounded (att-snn)."""
    recurrent_delay: Literal[1, 2] = 1
    """1: the chip's time convention; 2: the paper's equations (att-snn)."""
    finest_exponent: Annotated[int, Between(WEIGHT_EXP_MIN, 0)] = 0
    """Least exponent of the weights into a hidden neuron: steps of 1/128 times 2 to that power, where all of
    the neuron's weights are small enough (att-snn)."""
    inputs: InputScaling = PAPER_SCALING
    """Scaling of the six inputs."""
    outputs: Outputs = "roll-pitch"
    """Roll and pitch as in the paper; angular-acceleration trains a controller, in flights of its own."""
    fixed_taus: bool = False
    """Train the weights alone and leave the time constants as they are at first (att-snn)."""
    optimisation: Literal["paper", "layered"] = "paper"
    """The parameters, steps and end of the paper's published code; or parameters relative to their size,
    small steps of the later layers and a learning rate that falls (`training.config.OPTIMISATIONS`)."""
    optimiser_lr: Annotated[float, Between(1e-9, 10.0)] = 0.005
    """Learning rate of Adam."""

    epochs: Number = 500
    """Most epochs."""
    batches: Number = 15
    """Updates in an epoch."""
    batch_size: Number = 40
    """Windows in a batch."""
    window_s: Window = 10.0
    """Length of a window [s]."""
    windows_per_stream: Number = 1
    """Most successive windows over which the network's state continues (truncated backpropagation)."""
    augmentation: Augmentation = Augmentation()
    """Sensor errors and symmetries, drawn for every window or stream of an attitude estimator."""
    control: ControlSettings = ControlSettings()
    """Flights of a controller."""
    huber_threshold: Annotated[float, Between(0.0, 10.0, "rad")] = 0.0
    """Error above which the loss is linear, not quadratic, so that the unavoidable errors after an unknown
    initial attitude weigh less [rad]; 0: quadratic everywhere."""
    rate_cost: Annotated[float, Between(0.0, 1e6)] = 0.0
    """Weight of the spike rates above their targets [rad² per spike, neuron and step]."""
    rate_targets: tuple[Share, Share] = (0.1, 0.1)
    """Spikes per neuron and step that cost nothing, encoding and hidden layer."""

    @property
    def method(self) -> Optimisation:
        """What `optimisation` stands for."""
        return OPTIMISATIONS[self.optimisation]


class TrainConfig(TrainingRecipe):
    """A training run: a recipe, the network, its data and its seed."""

    model: Literal["att-snn", "att-rnn"] = "att-snn"
    """Spiking network, or its non-spiking twin."""
    data: tuple[str, ...] = ()
    """Datasets to train on; a controller has none."""
    validation: tuple[str, ...] = ()
    """Datasets to choose the best epoch by; none: a part of `data`, 70/20/10 by flight."""
    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    """Of the initial weights, the split, the windows and the sensor errors."""
    threads: Annotated[int, Between(1, 1024)] = 1
    """Threads that share a batch; the result depends on their number in the last digits only."""
    preset: str = "paper"
    """Preset that the other values started from: a shipped name or a TOML file."""

    @property
    def controls(self) -> bool:
        """Whether the network is a controller."""
        return self.outputs == CONTROL

    @model_validator(mode="after")
    def _fits(self) -> TrainConfig:
        unreserved(self.seed)
        layers = f"layers of {self.encoding} and {self.hidden}"
        if self.model == "att-rnn" and self.encoding != self.hidden:
            raise ValueError(f"att-rnn: {layers} units, should be equal")
        if self.controls:
            self._fits_control()
        elif not self.data:
            raise ValueError(
                "data: at least one dataset to train on is required, as quadsim generate makes it"
            )
        return self

    def _fits_control(self) -> None:
        if self.data or self.validation or self.model != "att-snn":
            raise ValueError(
                "a controller is an att-snn that flies itself: leave out data, validation and model"
            )
        if not self.quantised:
            raise ValueError("a controller is trained quantised")
        if self.epochs < self.control.rounds + 1:
            raise ValueError(
                f"epochs: {self.epochs}, should be at least the rounds, {self.control.rounds} + 1"
            )
        if self.window_s > self.control.flight_s:
            raise ValueError(f"window_s: {self.window_s:g}, should be at most control.flight_s")

    def steps(self, rate_hz: float) -> int:
        """Samples of a window."""
        return round(self.window_s * rate_hz)

    def round_of(self, epoch: int) -> int:
        """Round of a controller's flights that an epoch, counted from 0, belongs to."""
        return epoch * (self.control.rounds + 1) // self.epochs


def make_config(preset: str | Path = "paper", **choices: Any) -> TrainConfig:
    """A configuration from a preset and what differs from it.

    Args:
        preset: Name of a shipped preset, or a TOML file.
        choices: Fields of `TrainConfig`; of a table, only the keys that are given change.

    Raises:
        ValueError: One line: an unknown preset or field, or a value out of range.
    """
    values = load_toml(preset, "presets", TrainingRecipe).model_dump(exclude_unset=True)
    for name in {"data", "validation"} & choices.keys():
        paths = choices[name]
        choices[name] = (str(paths),) if isinstance(paths, str | Path) else tuple(map(str, paths))
    try:
        changed = merged(merged(TrainingRecipe().model_dump(), values), choices)
        config = TrainConfig.model_validate(changed | {"preset": str(preset)})
    except ValidationError as error:
        raise ValueError(f"training: {describe(error, TrainConfig)}") from error
    paths = [Path(path).resolve() for path in (*config.data, *config.validation)]
    if len(set(paths)) < len(paths):
        raise ValueError("data and validation: a dataset is given twice, its flights would count twice")
    return config
