"""What can be chosen about the training of a controller; the presets are the files of `assets/control`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from estimators.control.weights import Reads
from estimators.networks.weights_file import (
    InputScaling,
    NetworkConfig,
    OutputScale,
    SetPointScaling,
    load_network,
)
from quadsim.config.ranges import Between, Share
from quadsim.config.toml import Strict, describe, load_toml, merged
from quadsim.held_out import unreserved

from ..config import Number, TrainingRecipe

Degrees = Annotated[float, Between(0.0, 60.0, "°")]
Seconds = Annotated[float, Between(0.01, 60.0, "s")]
Scale = Annotated[float, Between(1e-3, 1e4, "rad/s²")]
KIND = "control"
"""Folder of the presets in `assets`."""
LEARNING: dict[str, Any] = {
    "encoding": 160,
    "hidden": 192,
    "finest_exponent": -6,
    "after_spike": True,
    "inputs": {"gyro": 2.5, "accel": (1.0, 1.0, 4.0), "accel_offset": (0.0, 0.0, 9.81)},
    "initialisation": "solved",
    "parametrisation": "logits",
    "optimiser_lr": 0.08,
    "layer_steps": (1.0, 0.3, 0.1),
    "adam_beta2": 0.99,
    "decay": "cosine",
    "clip": 1.0,
    "epochs": 48,
    "batches": 700,
    "batch_size": 16,
    "window_s": 1.5,
    "windows_per_stream": 12,
    "stop_early": False,
    "huber_threshold": 0.3,
    "rate_cost": 0.01,
    "rate_targets": (0.12, 0.15),
}
"""How a controller's network is trained, where that differs from the default of a `TrainingRecipe`."""
ATTITUDE_INPUTS = {"gyro": 2.5, "accel": (0.981, 0.981, 9.81), "accel_offset": (0.0, 0.0, 0.0)}
"""Of one that reads an attitude."""


class Excitation(Strict):
    """What is added to flights of the recipe, drawn for each flight and, in turn, for each part of it.

    All but the thrust of rotors and battery is scaled by a factor of the flight, the square of a uniform
    number: half of the flights are calm.
    """

    step_deg: Degrees = 20.0
    """Largest step of the roll and the pitch set-point [deg]."""
    step_s: tuple[Seconds, Seconds] = (0.2, 0.8)
    """Its shortest and longest duration [s]."""
    chirp_deg: Degrees = 10.0
    """Largest amplitude of a chirp of them [deg]."""
    chirp_hz: tuple[
        Annotated[float, Between(0.01, 50.0, "Hz")], Annotated[float, Between(0.01, 50.0, "Hz")]
    ] = (
        0.3,
        4.0,
    )
    """Range of its frequencies [Hz]."""
    yaw_rate: Annotated[float, Between(0.0, 10.0, "rad/s")] = 1.0
    """Largest step of the yaw-rate set-point [rad/s]."""
    still: Share = 0.6
    """Share of the parts of a flight without any of these."""
    pulse: Annotated[float, Between(0.0, 100.0, "rad/s²")] = 15.0
    """Largest pulse of angular acceleration about roll and pitch, a tenth of it about yaw [rad/s²]."""
    noise: Annotated[float, Between(0.0, 100.0, "rad/s²")] = 3.0
    """Standard deviation of a slowly varying disturbance of the command, likewise [rad/s²]."""
    rotor_spread: Annotated[float, Between(0.0, 0.5)] = 0.06
    """Largest loss of thrust of a rotor, as a share: a constant torque, as of a displaced centre of mass."""
    battery: Annotated[float, Between(0.5, 1.0)] = 0.8
    """Least thrust of all rotors over the nominal one."""
    start_tilt_deg: Degrees = 30.0
    """Largest tilt at the start, which no estimate knows [deg]."""


class ControlRecipe(Strict):
    """How a controller is trained: what a preset may set."""

    recipe: str = "control"
    """Flights: a shipped recipe or a TOML file. Its vehicle and IMU are the controller's."""
    excitation: Excitation = Excitation()
    """What is added to them."""
    reads: Reads = "imu"
    """What the network has beside the set-points: gyroscope and accelerometer, or gyroscope and an attitude,
    in training the true one."""
    estimator: str = ""
    """Att-SNN whose spikes the controller reads, a shipped name or a file; its weights do not change. Empty:
    the network reads the IMU itself and is trained end to end."""
    end_to_end: bool = False
    """Train the estimator's weights too, from where they are, with every connection: one merged network."""
    init: str = ""
    """Weights of a controller of the same layers to continue from, by a shipped name or a file."""
    decay_profiles: Annotated[int, Between(0, 32)] = 0
    """Decays that the neurons of `init` share, in profiles of the chip, which has 32 for a core, before the
    training, which keeps them. 0: as they are, free."""
    set_point: SetPointScaling = SetPointScaling()
    """Scaling and limits of the set-points, and the bound of the outputs."""
    output_scale: OutputScale = 32.0
    """Angular acceleration of an output potential of 1.0 [rad/s²]."""
    delay_shift: Annotated[int, Between(0, 20)] = 0
    """Samples by which targets are the teacher's later ones, to make up for the delay of the network."""
    error_scale: tuple[Scale, Scale, Scale] = (10.0, 10.0, 2.0)
    """Errors about roll, pitch and yaw that weigh the same in the loss [rad/s²]."""
    flights: Number = 64
    """Flights by the teacher, which the first round learns from."""
    flight_s: Seconds = 16.0
    """Length of a flight [s]."""
    rounds: Annotated[int, Between(0, 100)] = 11
    """Further rounds, in each of which the student flies too and the teacher labels its flights (DAgger, Ross
    et al. 2011)."""
    round_flights: Number = 48
    """Flights that each of them adds."""
    teacher_share: Share = 0.5
    """Share of the time at which the teacher flies in the first of them, to the power k in the k-th."""
    validation_flights: Number = 24
    """Flights by the student alone after each epoch, to choose the best by."""
    learning: TrainingRecipe = Field(default_factory=lambda: TrainingRecipe.model_validate(LEARNING))
    """Network and optimisation."""


class ControlConfig(ControlRecipe):
    """A training run of a controller."""

    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    """Of the flights, the initial weights and the windows."""
    threads: Annotated[int, Between(1, 1024)] = 1
    """Threads that share a batch."""
    preset: str = "separate"
    """Preset that the other values started from."""

    @model_validator(mode="after")
    def _fits(self) -> ControlConfig:
        unreserved(self.seed)
        learning = self.learning
        if (
            not learning.quantised
            or learning.symmetric
            or learning.pruning_target
            or learning.reinitialise_until
        ):
            raise ValueError(
                "learning: a controller is trained quantised, without symmetric, pruning_target and "
                "reinitialise_until"
            )
        if self.reads == "attitude" and self.estimator:
            raise ValueError("reads: attitude, and an estimator; give one of them")
        if self.estimator and learning.steps_per_sample != 1:
            raise ValueError(
                f"learning.steps_per_sample: {learning.steps_per_sample}, but the estimator runs a step for "
                "each sample"
            )
        if self.decay_profiles and not (self.init and learning.fixed_taus):
            raise ValueError(
                "decay_profiles: give init, whose decays are shared, and learning.fixed_taus = true"
            )
        if self.end_to_end and not self.estimator:
            raise ValueError("end_to_end: without an estimator every network is; leave it out")
        if learning.epochs < self.rounds + 1:
            raise ValueError(
                f"learning.epochs: {learning.epochs}, should be at least the rounds, {self.rounds} + 1"
            )
        if learning.window_s > self.flight_s:
            raise ValueError(f"learning.window_s: {learning.window_s:g}, should be at most flight_s")
        return self

    def round_of(self, epoch: int) -> int:
        """Round that an epoch, counted from 0, belongs to."""
        return epoch * (self.rounds + 1) // self.learning.epochs


def make_control_config(preset: str | Path = "separate", **choices: Any) -> ControlConfig:
    """A configuration from a preset and what differs from it.

    Args:
        preset: Name of a shipped preset ("separate", "merged", "attitude"), or a TOML file.
        choices: Fields of `ControlConfig`; of a table, only the keys that are given change.

    Raises:
        FileNotFoundError: No such estimator.
        ValueError: One line: an unknown preset or field, or a value out of range.
    """
    values = load_toml(preset, KIND, ControlRecipe).model_dump(exclude_unset=True)
    reads_attitude = choices.get("reads", values.get("reads")) == "attitude"
    learning = LEARNING | ({"inputs": ATTITUDE_INPUTS} if reads_attitude else {})
    changed = merged(merged({"learning": learning}, values), choices)
    if estimator := changed.get("estimator"):
        network = read_estimator(estimator)[0]
        learning = changed["learning"] | {name: getattr(network, name) for name in ("after_spike", "inputs")}
        learning["finest_exponent"] = -6
        changed["learning"] = learning | {"inputs": InputScaling.model_dump(network.inputs)}
    try:
        return ControlConfig.model_validate(changed | {"preset": str(preset)})
    except ValidationError as error:
        raise ValueError(f"training: {describe(error, ControlConfig)}") from error


def read_estimator(path: str | Path) -> tuple[NetworkConfig, dict[str, Any]]:
    """The estimator in front of a controller.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not a network that runs on the chip, once for each sample.
    """
    config, tensors = load_network(path)
    if config.controls or config.model != "att-snn":
        raise ValueError(f"estimator: {path} is no Att-SNN, give weights of one")
    if not config.quantised or config.recurrent_delay != 1 or config.steps_per_sample != 1:
        raise ValueError(f"estimator: {path} does not run on the chip, a step for each sample")
    return config, tensors
