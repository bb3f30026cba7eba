"""What can be chosen about a training run; the presets are the files of `assets/presets`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from estimators.networks.symmetry import is_symmetric
from estimators.networks.weights_file import (
    EXPONENT_MIN,
    EXPONENTS,
    PAPER_SCALING,
    InputScaling,
    Neurons,
    Outputs,
    OutputScale,
    StepsPerSample,
    attitude_network,
    number_of,
)
from quadsim.config.ranges import Between, Share
from quadsim.config.toml import Strict, describe, load_toml, merged
from quadsim.held_out import unreserved

from .augment import Augmentation

Number = Annotated[int, Between(1, 1_000_000)]
Step = Annotated[float, Between(1e-6, 1e6)]
Parametrisation = Literal["decays", "logits"]
Window = Annotated[float, Between(0.01, 3600.0, "s")]


class TrainingRecipe(Strict):
    """How a network is trained: what a preset may set. The defaults are the paper's recipe."""

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
    finest_exponent: Annotated[int, Between(EXPONENT_MIN, 0)] = 0
    """Least exponent of the weights into a hidden neuron: steps of 1/128 times 2 to that power, where all of
    the neuron's weights are small enough (att-snn). A run that continues from weights has at least theirs."""
    after_spike: bool = False
    """Give each hidden neuron an after-spike current: a weight and a time constant of its own by which its
    spikes act on itself (att-snn)."""
    steps_per_sample: StepsPerSample = 1
    """Network steps for each IMU sample (att-snn)."""
    inputs: InputScaling = PAPER_SCALING
    """Scaling of the six inputs."""
    outputs: Outputs = "roll-pitch"
    """Roll and pitch as in the paper, or the world's up in body axes (3), for attitudes where these are
    singular."""
    output_scale: OutputScale = 1.0
    """Radians, or parts of a unit vector, for an output potential of 1.0 (att-snn)."""
    initialisation: Literal["random", "solved"] = "random"
    """Random weights of unit scale, or a leaky integrator solved by ridge regression (att-snn)."""
    parametrisation: Parametrisation = "decays"
    """What the optimiser's parameters are. "decays", as in the paper's published code: 1 - τ, and weights
    over 1 - τ_mem. "logits": those of τ, and weights over the root mean square of their row (att-snn)."""
    fixed_taus: bool = False
    """Train the weights alone and leave the time constants as they are at first (att-snn)."""
    reinitialise_until: Share = 0.0
    """Share of the epochs, from the first, that begin with new inputs for hidden neurons that never or always
    spike (att-snn)."""
    pruning_target: Annotated[int, Between(0, 10**8)] = 0
    """Most connections and time constants after pruning, which removes the connections with the smallest
    effect on the loss during training (att-snn); 0: no pruning."""
    pruning_span: tuple[Share, Share] = (0.25, 0.7)
    """Shares of the epochs between which connections are pruned."""

    optimiser_lr: Annotated[float, Between(1e-9, 10.0)] = 0.005
    """Learning rate of Adam."""
    layer_steps: tuple[Step, Step, Step] = (1.0, 1.0, 1.0)
    """Its factors for the encoding, the hidden and the output weights (att-snn)."""
    adam_beta2: Annotated[float, Between(1e-3, 1.0 - 1e-6)] = 0.999
    """Decay of Adam's second moment."""
    decay: Literal["none", "cosine"] = "none"
    """Learning rate over the epochs: constant, or half a cosine down to a hundredth."""
    clip: Annotated[float, Between(0.0, 1e6)] = 5.0
    """Largest norm of the gradient, as in the paper's published code; 0: no limit."""
    lookahead_k: Number = 6
    """Steps of the fast weights for one of the slow."""
    lookahead_alpha: Annotated[float, Between(1e-3, 1.0)] = 0.5
    """Step of the slow weights, as a share of the distance to the fast."""

    epochs: Number = 500
    """Most epochs."""
    batches: Number = 15
    """Updates in an epoch."""
    batch_size: Number = 40
    """Windows in a batch."""
    window_s: Window = 10.0
    """Length of a window [s]."""
    later_windows: tuple[tuple[Share, Window], ...] = ()
    """Other lengths of a window later on: the share of the epochs after which each is used, rising, and the
    length [s]."""
    windows_per_stream: Number = 1
    """Most successive windows over which the network's state continues (truncated backpropagation)."""
    stop_early: bool = True
    """Stop by the paper's rules: 20-epoch average above 110 % of its lowest, or the lowest 50 epochs old."""
    augmentation: Augmentation = Augmentation()
    """Sensor errors and symmetries, drawn for every window or stream."""
    huber_threshold: Annotated[float, Between(0.0, 10.0, "rad")] = 0.0
    """Error above which the loss is linear, not quadratic, so that the unavoidable errors after an unknown
    initial attitude weigh less [rad, of up its norm]; 0: quadratic everywhere."""
    rate_cost: Annotated[float, Between(0.0, 1e6)] = 0.0
    """Weight of the spike rates above their targets [rad² per spike, neuron and step]."""
    rate_targets: tuple[Share, Share] = (0.1, 0.1)
    """Spikes per neuron and step that cost nothing, encoding and hidden layer."""


class Preset(TrainingRecipe):
    """A file of `assets/presets`, or a user's."""

    needs_init: bool = False
    """Whether a run continues from weights, which `init` has to name."""
    att_rnn: TrainingRecipe = Field(default=TrainingRecipe(), alias="att-rnn")
    """What differs for att-rnn."""


class TrainConfig(TrainingRecipe):
    """A training run: a recipe, the network, its data and its seed."""

    model: Literal["att-snn", "att-rnn"] = "att-snn"
    """Spiking network, or its non-spiking twin."""
    data: tuple[str, ...]
    """Datasets to train on."""
    validation: tuple[str, ...] = ()
    """Datasets to choose the best epoch by; none: a part of `data`, 70/20/10 by flight."""
    folds: Annotated[int, Between(0, 1000)] = 0
    """Parts into which the flights of `data` are dealt, one of them held out as a test; 0: no test."""
    fold: Annotated[int, Between(0, 999)] = 0
    """The part that is held out, counted from 0."""
    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    """Of the initial weights, the split, the windows and the sensor errors."""
    threads: Annotated[int, Between(1, 1024)] = 1
    """Threads that share a batch; the result depends on their number in the last digits only."""
    preset: str = "paper"
    """Preset that the other values started from: a shipped name or a TOML file."""
    init: str = ""
    """Weights to continue from, in place of `initialisation`: a file or a shipped name; they fix the layers
    and the scaling."""

    @model_validator(mode="after")
    def _fits(self) -> TrainConfig:
        unreserved(self.seed)
        constants = 2 * (self.encoding + self.hidden) + 2 + self.after_spike * self.hidden
        if self.model == "att-snn" and 0 < self.pruning_target <= constants:
            raise ValueError(
                f"pruning_target: {self.pruning_target}, but time constants alone are {constants}"
            )
        if self.fixed_taus and self.reinitialise_until > 0:
            raise ValueError(
                f"reinitialise_until: {self.reinitialise_until}, but re-initialised neurons get new time "
                "constants and fixed_taus keeps them; give reinitialise_until=0, or fixed_taus=false"
            )
        shares = [share for share, _ in self.later_windows]
        if sorted(set(shares)) != shares:
            raise ValueError(f"later_windows: shares {shares}, each should be above the one before")
        if not 0 <= self.pruning_span[0] < self.pruning_span[1] <= 1:
            raise ValueError(f"pruning_span: {self.pruning_span}, should be two rising shares in 0...1")
        if self.prunes and self.reinitialise_until > self.pruning_span[0]:
            raise ValueError(
                f"reinitialise_until: {self.reinitialise_until}, but connections are pruned from "
                f"{self.pruning_span[0]} on; give a smaller reinitialise_until, or pruning_target=0"
            )
        return self

    def window_s_in(self, epoch: int) -> float:
        """Length of the windows of an epoch, counted from 0 [s]."""
        lengths = [length for share, length in self.later_windows if epoch >= share * self.epochs]
        return lengths[-1] if lengths else self.window_s

    @property
    def prunes(self) -> bool:
        """Whether the network with every connection has more parameters than pruning leaves."""
        h0, h1 = self.encoding, self.hidden
        unpruned = 6 * h0 + h0 * h1 + h1 * h1 + number_of(self.outputs) * h1 + 2 * (h0 + h1) + 2
        unpruned += 2 * h1 * self.after_spike
        return self.model == "att-snn" and 0 < self.pruning_target < unpruned


FROM_WEIGHTS = (
    "encoding", "hidden", "quantised", "recurrent_delay", "after_spike", "steps_per_sample", "outputs",
    "output_scale",
)  # fmt: skip
"""Fields that the weights of `init` fix."""


def make_config(preset: str | Path = "paper", **choices: Any) -> TrainConfig:
    """A configuration from a preset and what differs from it.

    Args:
        preset: Name of a shipped preset, or a TOML file.
        choices: Fields of `TrainConfig`; of a table, only the keys that are given change.

    Raises:
        ValueError: One line: an unknown preset or field, or a value out of range.
    """
    loaded = load_toml(preset, "presets", Preset)
    values = loaded.model_dump(exclude_unset=True, exclude={"needs_init", "att_rnn"})
    if choices.get("model") == "att-rnn":
        values = merged(values, loaded.att_rnn.model_dump(exclude_unset=True))
    for name in {"data", "validation"} & choices.keys():
        paths = choices[name]
        choices[name] = (str(paths),) if isinstance(paths, str | Path) else tuple(map(str, paths))
    if choices.get("init"):
        values |= _from_weights(choices, values)
    elif loaded.needs_init:
        raise ValueError(f"preset {preset} continues from weights: give init, a shipped name or a file")
    try:
        changed = merged(merged(TrainingRecipe().model_dump(), values), choices)
        config = TrainConfig.model_validate(changed | {"preset": str(preset)})
    except ValidationError as error:
        raise ValueError(f"training: {describe(error, TrainConfig)}") from error
    paths = [Path(path).resolve() for path in (*config.data, *config.validation)]
    if len(set(paths)) < len(paths):
        raise ValueError("data and validation: a dataset is given twice, its flights would count twice")
    return config


def _from_weights(choices: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    """The fields that follow from the weights of `init`."""
    init = choices["init"] = str(choices["init"])
    network, tensors = attitude_network(init)
    fixed = {name: getattr(network, name) for name in FROM_WEIGHTS}
    for name, value in fixed.items():
        if choices.get(name, value) != value:
            raise ValueError(f"{name}: the weights of init have {value}, it cannot be {choices[name]}")
    shared = is_symmetric(tensors)
    if choices.get("symmetric") and not shared:
        raise ValueError(f"symmetric: {init} does not share its weights, give symmetric=false")
    finest = min((int(tensors[name].min()) for name in EXPONENTS.values() if name in tensors), default=0)
    fixed["finest_exponent"] = min(finest, values.get("finest_exponent", 0))
    fixed |= {"inputs": network.inputs, "symmetric": values.get("symmetric", False) and shared}
    return {"reinitialise_until": 0.0, **fixed}
