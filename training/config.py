"""Configuration of a training run; `assets/presets` contains the presets."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, ValidationError, model_validator

from estimators.circuit.file import load_circuit
from estimators.loihi.layers import WEIGHT_EXP_MIN
from estimators.networks.weights_file import PAPER_SCALING, InputScaling, Layers, SetPointScaling
from quadsim.config.ranges import Between, Share
from quadsim.config.toml import Strict, describe, load_toml, merged, preset_names, shipped_folder
from quadsim.flight.recipe import NamedImu, Variant
from quadsim.held_out import unreserved
from quadsim.imu.spec import ImuSpec, Sensor

Number = Annotated[int, Between(1, 1_000_000)]
Window = Annotated[float, Between(0.01, 3600.0, "s")]
Scale = Annotated[float, Between(1e-3, 1e4, "rad/s²")]
SNN = "att-snn"
EPOCH_UPDATES = 500
"""Number of updates in an epoch of a circuit."""


class Optimisation(NamedTuple):
    """Parametrisation and step sizes of the optimiser."""

    logits: bool
    """Whether the trained parameters are logits of τ, and weights divided by the RMS of their row. Otherwise,
    they are 1 - τ, and weights divided by 1 - τ_mem, as in the paper's published code (att-snn)."""
    layer_steps: tuple[float, float, float]
    """Factors of the learning rate for the encoding, the hidden and the output weights (att-snn)."""
    adam_beta2: float
    """Decay of Adam's second moment."""
    cosine: bool
    """Whether the learning rate decreases over the epochs, by half a cosine to a hundredth."""
    clip: float
    """Largest norm of the gradient."""
    stop_early: bool
    """Whether the paper's rules stop a run; see `training.optim.finished`."""


OPTIMISATIONS = {
    "paper": Optimisation(False, (1.0, 1.0, 1.0), 0.999, False, 5.0, True),
    "layered": Optimisation(True, (1.0, 0.3, 0.1), 0.99, True, 1.0, False),
}


class ControlSettings(Strict):
    """Training flights of a controller: flights by a teacher, then labelled flights by the controller."""

    recipe: str = "control"
    """Recipe of the flights: a shipped name or a TOML file. It also defines vehicle and IMU of the
    controller."""
    set_point: SetPointScaling = SetPointScaling()
    """Scaling and limits of the set-points, and bound of the outputs."""
    error_scale: tuple[Scale, Scale, Scale] = (10.0, 10.0, 2.0)
    """Errors about roll, pitch and yaw with equal weight in the loss [rad/s²]."""
    flights: Number = 24
    """Number of flights by the teacher in the first round."""
    flight_s: Annotated[float, Between(0.01, 60.0, "s")] = 16.0
    """Length of a flight [s]."""
    rounds: Annotated[int, Between(0, 100)] = 11
    """Number of further rounds, in which the student also flies and the teacher labels the flights (DAgger,
    Ross et al. 2011)."""
    round_flights: Number = 40
    """Number of flights that each further round adds."""
    teacher_share: Share = 0.3
    """Base b of the share of the time for which the teacher flies, which is b^k in further round k."""
    validation_flights: Number = 24
    """Number of flights by the student after each epoch, which select the best epoch."""


class TrainingRecipe(Layers):
    """Settings of a preset for a network of layers. The defaults are the paper's recipe."""

    finest_exponent: Annotated[int, Between(WEIGHT_EXP_MIN, 0)] = 0
    """Smallest exponent e of the weights into a hidden neuron. If all weights of the neuron are small enough,
    they have steps of 2^e / 128 (att-snn)."""
    inputs: InputScaling = PAPER_SCALING
    """Scaling of the readings."""
    fixed_taus: bool = False
    """Whether to train only the weights and keep the initial time constants (att-snn)."""
    optimisation: Literal["paper", "layered"] = "paper"
    """Optimisation as in the paper's published code; or with relative parameters, small steps of later layers
    and a decreasing learning rate (`training.config.OPTIMISATIONS`)."""
    optimiser_lr: Annotated[float, Between(1e-9, 10.0)] = 0.005
    """Learning rate of Adam."""

    epochs: Number = 500
    """Maximum number of epochs."""
    batches: Number = 15
    """Number of updates in an epoch."""
    batch_size: Number = 40
    """Number of windows in a batch."""
    window_s: Window = 10.0
    """Length of a window [s]."""
    windows_per_stream: Number = 1
    """Largest number of successive windows over which the state continues (truncated backpropagation)."""
    imu: NamedImu = ImuSpec(gyro=Sensor(noise=3.394e-4), accel=Sensor(noise=0.004, turn_on=0.196))
    """IMU whose errors are drawn for every stream of an attitude estimator. The paper used RotorS'
    ADIS16448."""
    control: ControlSettings = ControlSettings()
    """Training flights of a controller."""
    huber_threshold: Annotated[float, Between(0.0, 10.0, "rad")] = 0.0
    """Error above which the loss is linear instead of quadratic, so that unavoidable errors after an unknown
    start have less weight [rad]; 0: quadratic everywhere."""
    rate_cost: Annotated[float, Between(0.0, 1e6)] = 0.0
    """Weight of spike rates above their targets [rad² per spike, neuron and step]."""
    rate_targets: tuple[Share, Share] = (0.1, 0.1)
    """Spikes per neuron and step without a cost, for encoding and hidden layer."""

    @property
    def method(self) -> Optimisation:
        """Settings that `optimisation` selects."""
        return OPTIMISATIONS[self.optimisation]


class FlightSet(Variant):
    """A set of training flights of a recipe."""

    flights: dict[str, Number] = Field(min_length=1)
    """Number of flights of each vehicle."""


class CircuitTraining(Strict):
    """Settings of a preset for a circuit, such as `assets/presets/att-snn.toml`."""

    vectors: Annotated[int, Between(4, 64)] = 6
    """Number of rotating vectors."""
    gates: Annotated[int, Between(8, 256)] = 16
    """Number of gated innovations."""
    streams: Number = 1536
    """Number of streams; the sensor errors of each are drawn once."""
    window_s: Annotated[float, Between(0.1, 600.0, "s")] = 40.0
    """Length of a stream, over which the gradient is computed [s]."""
    flight_sets: tuple[FlightSet, ...] = ()
    """Training flights of 60 s that are generated if no data are given."""
    hand_share: Share = 0.4
    """Share of hand-held streams, if the data contain hand-held motion and flight."""
    sway_share: Share = 0.7
    """Share of the hand-held streams with additional translation."""
    calibrated_share: Share = 0.5
    """Share of the streams with a calibrated IMU: a tenth of the biases, scale and mounting errors."""
    interrupted_share: Share = 0.15
    """Share of the streams with a gap of up to half a second and a few wrong rates."""
    known_share: Share = 0.35
    """Share of the streams that begin with a known attitude and bias, like the later parts of a flight."""
    updates: Number = 6500
    """Number of updates of the weights."""
    batch_size: Annotated[int, Between(1, 1024)] = 16
    """Number of streams in an update."""
    learning_rate: Annotated[float, Between(1e-6, 1.0)] = 0.02
    """Highest learning rate of Adam."""
    imu: NamedImu = ImuSpec()
    """The worst IMU. The IMU of each stream has random shares of its errors (`training.circuit.imus`)."""
    init: str = ""
    """Circuit to continue training, as a file or a shipped name, instead of the initial circuit. It must have
    the same numbers of vectors and gates."""


class Run(Strict):
    """Settings of every training run."""

    data: tuple[str, ...] = ()
    """Datasets to train on; none for a controller."""
    validation: tuple[str, ...] = ()
    """Datasets that select the best epoch; by default, a part of `data` (70/20/10 by flight). For a circuit,
    the datasets only report the error."""
    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    """Seed of all random numbers: initial weights, split, windows or streams, sensor errors."""

    def check(self, own_flights: bool) -> None:
        """Refuse a reserved seed, and a run without data that does not generate flights."""
        unreserved(self.seed)
        if not (self.data or own_flights):
            raise ValueError(
                "data: at least one dataset to train on is required, as quadsim generate makes it"
            )


class CircuitRun(Run, CircuitTraining):
    """A training run of a circuit."""

    @model_validator(mode="after")
    def _has_data(self) -> CircuitRun:
        self.check(bool(self.flight_sets))
        return self

    @property
    def epochs(self) -> int:
        """Number of epochs of `EPOCH_UPDATES` updates; the last epoch may have fewer."""
        return -(-self.updates // EPOCH_UPDATES)


class TrainConfig(Run, TrainingRecipe):
    """A training run of a network of layers."""

    model: Literal["att-snn", "att-rnn"] = SNN
    """The spiking network, or the GRU network."""
    preset: str = "paper"
    """Preset of the run: a shipped name or a TOML file."""

    @property
    def controls(self) -> bool:
        """Whether the network is a controller."""
        return self.outputs == "angular-acceleration"

    @model_validator(mode="after")
    def _fits(self) -> TrainConfig:
        self.check(self.controls)
        if self.model == "att-rnn" and self.encoding != self.hidden:
            raise ValueError(f"att-rnn: layers of {self.encoding} and {self.hidden} units, should be equal")
        paths = [Path(path).resolve() for path in (*self.data, *self.validation)]
        if len(set(paths)) < len(paths):
            raise ValueError("data and validation: a dataset is given twice, its flights would count twice")
        if not self.controls:
            return self
        if paths or self.model != SNN:
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
        return self

    def steps(self, rate_hz: float) -> int:
        """Number of samples in a window."""
        return round(self.window_s * rate_hz)

    def round_of(self, epoch: int) -> int:
        """Return the round of a controller's flights for an epoch, counted from 0."""
        return epoch * (self.control.rounds + 1) // self.epochs


def is_of_circuit(preset: str | Path) -> bool:
    """Return whether a preset, shipped or a TOML file, is that of a circuit."""
    shipped = str(preset) in preset_names("presets")
    file = shipped_folder("presets") / f"{preset}.toml" if shipped else Path(preset)
    try:
        keys = tomllib.loads(file.read_text("utf-8")).keys()
    except (OSError, ValueError):
        return False
    return not keys.isdisjoint(CircuitTraining.model_fields.keys() - TrainingRecipe.model_fields.keys())


def make_config(preset: str | Path = "paper", **choices: Any) -> TrainConfig | CircuitRun:
    """Make a configuration from a preset and changes.

    Args:
        preset: Name of a shipped preset, or a TOML file.
        choices: Changed fields of `TrainConfig` or `CircuitRun`; in a table, only the given keys change.

    Raises:
        ValueError: The preset or a field is unknown, or a value is out of range.
    """
    for name in {"data", "validation"} & choices.keys():
        paths = choices[name]
        choices[name] = (str(paths),) if isinstance(paths, str | Path) else tuple(map(str, paths))
    if is_of_circuit(preset):
        recipe, kind = CircuitTraining, CircuitRun
        layered = {"model": choices.pop("model", SNN) != SNN, "epochs": "epochs" in choices}
        if wrong := [name for name, given in layered.items() if given]:
            raise ValueError(
                f"--{wrong[0]} is not for the circuit of {preset}: leave it out, or give --preset paper"
            )
    else:
        recipe, kind = TrainingRecipe, TrainConfig
        choices["preset"] = str(preset)
    try:
        run = kind.model_validate(merged(load_toml(preset, "presets", recipe).model_dump(), choices))
    except ValidationError as error:
        raise ValueError(f"training: {describe(error, kind)}") from error
    if isinstance(run, CircuitRun) and run.init:
        continued = load_circuit(run.init).config
        run = run.model_copy(update={"vectors": continued.vectors, "gates": continued.gates})
    return run
