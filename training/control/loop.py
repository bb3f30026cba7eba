"""The training loop of a controller: flights by the teacher, epochs of windows, rounds of its own flights.

A run's folder holds `config.json`, `round-*.npz` with the flights of each round, `log.csv` (a row per epoch),
`checkpoint.pt`, `best.safetensors` and `curve.png`. A run that was stopped continues from its checkpoint and
ends with the same weights.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from estimators.control.controller import SpikingController, follow
from estimators.control.weights import ControllerWeights, load_controller, save_controller
from estimators.networks.decay_profiles import share_profiles
from estimators.networks.encoder import ENCODER, INPUT_ONE, scaled_inputs
from estimators.networks.weights_file import load_network
from quadsim.flight.recipe import flight_config, load_recipe
from quadsim.runs.files import alone, save_figure, write_csv, write_whole
from quadsim.runs.fingerprint import code_digest
from quadsim.runs.record import commit
from quadsim.seeding import child

from ..init import initialise_from_weights
from ..loop import INTERRUPTED
from ..loss import attitude_loss
from ..optim import learning_rate, new_optimiser
from ..run_folder import claim, save_checkpoint, spiking_tensors
from .config import ControlConfig, make_control_config
from .flights import SIGNALS, ControlFlights, fly, joined
from .model import Frozen, estimator_of, initialise, network_of, new_model, no_estimator

log = logging.getLogger(__name__)

FLIGHTS, VALIDATION, INITIAL, WINDOWS = range(4)
"""Children of a run's seed."""
CRASH_DEG = 90.0
"""What a crashed validation flight counts as [deg]."""
INITIAL_WINDOWS = 24
"""Windows that the initial network is solved on, and"""
INITIAL_S = 6.0
"""their length [s]."""


@dataclass(frozen=True)
class ControlEpoch:
    """A row of the log."""

    epoch: int
    round: int
    updates: int
    train_loss: float
    """Mean over the epoch, in units of the error scale."""
    imitation: float
    """Root mean square error of the outputs on the student's own validation flights, over the error scale."""
    tracking_deg: float
    """Root mean square angle between commanded and true thrust axis in them; 90° for a crashed one [deg]."""
    teacher_deg: float
    """The same of the teacher [deg]."""
    crashes: int
    """Of the student's validation flights."""
    rate_encoding: float
    """Spikes per neuron and step while training."""
    rate_hidden: float
    learning_rate: float
    seconds: float
    """Time of training so far."""


Progress = Callable[[ControlEpoch, ControlConfig], None]


@dataclass(frozen=True)
class ControlResult:
    """How a run ended."""

    weights: Path
    """File of the best epoch's weights."""
    best: ControlEpoch
    reason: str
    """Why it ended."""


class Window(NamedTuple):
    """One window of every stream: signals (n, T, ·), and the streams (n,) that begin here."""

    gyro: NDArray[np.float32]
    accel: NDArray[np.float32]
    set_point: NDArray[np.float32]
    target: NDArray[np.float32]
    reset: NDArray[np.bool_]


def train_controller(
    out: str | Path = "runs/control",
    preset: str | Path = "separate",
    progress: Progress | None = None,
    **choices: Any,
) -> ControlResult:
    """Train a controller, or continue a run that was stopped.

    Args:
        out: Folder of the run.
        preset: "separate", "merged", "attitude" or a TOML file.
        progress: Called after every epoch.
        choices: Fields of `ControlConfig` that differ from the preset.

    Raises:
        FileNotFoundError: No such estimator.
        ValueError: A bad choice, or another run's folder.
    """
    return run(make_control_config(preset, **choices), Path(out), progress)


def run(config: ControlConfig, out: Path, progress: Progress | None = None) -> ControlResult:
    """As `train_controller`, from a complete configuration."""
    with alone(out):
        return _run(config, out, progress)


def _run(config: ControlConfig, out: Path, progress: Progress | None) -> ControlResult:
    threads = torch.get_num_threads()
    torch.set_num_threads(config.threads)
    try:
        claim(out, config, contents_of(config))
        training = ControlTraining(config, out)
        if (out / "checkpoint.pt").is_file():
            training.restore(torch.load(out / "checkpoint.pt", weights_only=True))
        reason = _all_epochs(training, out, progress)
    finally:
        torch.set_num_threads(threads)
    if not training.history:
        raise ValueError(f"{out}: stopped before the first epoch was over ({reason}), nothing to save")
    plot(out, training.history)
    return ControlResult(out / "best.safetensors", min(training.history, key=rank), reason)


def contents_of(config: ControlConfig) -> dict[str, str]:
    """Digests of what a run reads, so that a run on other files is refused."""
    flights = flight_config(load_recipe(config.recipe))
    digests = {"flights": flights.model_dump_json(), "code": code_digest("training.control.loop")}
    for name in ("estimator", "init"):
        if path := getattr(config, name):
            digest = hashlib.blake2b(digest_size=16)
            network, tensors = load_network(path)
            digest.update(network.model_dump_json(exclude={"training"}).encode())
            for tensor, value in sorted(tensors.items()):
                digest.update(tensor.encode() + value.tobytes())
            digests[name] = digest.hexdigest()
    return digests


def check_init(config: ControlConfig) -> None:
    """Refuse to continue from a controller of other inputs or outputs.

    Raises:
        ValueError: It reads something else, or scales differ.
    """
    network, _, reads = load_controller(config.init)
    given = {"reads": reads, "inputs": network.inputs, "set_point": network.set_point}
    given |= {"output_scale": network.output_scale, "steps_per_sample": network.steps_per_sample}
    own = {"reads": config.reads, "inputs": config.learning.inputs, "set_point": config.set_point}
    own |= {"output_scale": config.output_scale, "steps_per_sample": config.learning.steps_per_sample}
    if different := [name for name, value in given.items() if value != own[name]]:
        raise ValueError(f"init: {config.init} has other {', '.join(different)} than this training")


def rank(epoch: ControlEpoch) -> float:
    """The best epoch has the least: the tracking error of the student's flights."""
    return epoch.tracking_deg


def _all_epochs(training: ControlTraining, out: Path, progress: Progress | None) -> str:
    config, history = training.config, training.history
    try:
        while len(history) < config.learning.epochs:
            epoch = training.one_epoch()
            history.append(epoch)
            if rank(epoch) <= min(map(rank, history)):
                training.save_best(out, epoch)
            save_checkpoint(out, training.checkpoint())
            write_csv(out / "log.csv", [asdict(each) for each in history])
            if progress:
                progress(epoch, config)
    except KeyboardInterrupt:
        return INTERRUPTED
    except FloatingPointError as error:
        log.error("%s: training stopped, the best weights so far stay", error)
        return str(error)
    return f"all {config.learning.epochs} epochs done"


class ControlTraining:
    """A run in memory: flights, network, optimiser and the epochs so far."""

    def __init__(self, config: ControlConfig, out: Path) -> None:
        self.config, self.out = config, out
        recipe = flight_config(load_recipe(config.recipe))
        self.recipe, self.rate_hz = recipe, 200.0
        self.rounds = [self._round(0)]
        self.estimator = estimator_of(config)
        torch.manual_seed(config.seed)
        self.model = new_model(config, self.estimator)
        seed = np.random.SeedSequence([config.seed, INITIAL])
        length = {"window_s": min(INITIAL_S, config.flight_s)}
        long = config.model_copy(update={"learning": config.learning.model_copy(update=length)})
        window = next(windows(self.rounds[0], long, seed, INITIAL_WINDOWS))
        per_sample = config.learning.steps_per_sample
        target = np.repeat(window.target, per_sample, 1)
        initialise(self.model, self.estimator, self._inputs(window).numpy(), target, config.seed)
        if config.init:
            check_init(config)
            initialise_from_weights(self.model, self._begun())
        self.frozen = Frozen(self.model, no_estimator() if config.end_to_end else self.estimator)
        self.optimiser = new_optimiser(self.model, config.learning)
        self.history: list[ControlEpoch] = []
        self._state = np.zeros(config.learning.batch_size, ENCODER)
        self._scale = torch.tensor(config.error_scale, dtype=torch.float32)
        self.teacher_deg = _tracking(self._fly_validation(None))

    def _begun(self) -> str | Path:
        """Weights to continue from, with shared decays where the recipe asks for them."""
        if not self.config.decay_profiles:
            return self.config.init
        weights = load_controller(self.config.init)
        shared = share_profiles(weights.tensors, self.config.decay_profiles)
        file = self.out / "begun.safetensors"
        save_controller(file, weights._replace(tensors=shared))
        return file

    def _seeds(self, *key: int, n: int) -> list[np.random.SeedSequence]:
        return [child(np.random.SeedSequence([self.config.seed, *key]), i) for i in range(n)]

    def _round(self, number: int) -> ControlFlights:
        """Flights of a round, from its file where there is one: the student's, after the teacher's.

        A controller to continue from flies at once.
        """
        config, file = self.config, self.out / f"round-{number}.npz"
        if not file.is_file():
            seeds = self._seeds(FLIGHTS, number, n=config.flights if number == 0 else config.round_flights)
            student, share = None, 1.0
            if number or config.init:
                begun = self.student() if number else _controller(load_controller(config.init))
                student, share = begun, config.teacher_share ** max(number, 1)
            flights = fly(config, self.recipe, seeds, student, share)
            save_flights(file, flights)
        return read_flights(file)

    def _fly_validation(self, student: SpikingController | None) -> ControlFlights:
        seeds = self._seeds(VALIDATION, n=self.config.validation_flights)
        return fly(self.config, self.recipe, seeds, student)

    def exported(self, note: dict[str, Any]) -> ControllerWeights:
        """The slow weights as a controller runs them."""
        with self.optimiser.evaluated():
            tensors = spiking_tensors(self.model, self.config.learning)
        network = network_of(self.config, self.model, self.rate_hz, note)
        return ControllerWeights(network, tensors, self.config.reads)

    def student(self) -> SpikingController:
        """The network so far as a controller."""
        return _controller(self.exported({}))

    def _inputs(self, window: Window, state: NDArray[np.void] | None = None) -> torch.Tensor:
        """Scaled inputs of each network step, (n, steps, 9)."""
        learning = self.config.learning
        readings = scaled_inputs(learning.inputs, window.gyro, window.accel, state)
        wanted = follow(self.config.set_point, window.set_point.astype(np.float64)).inputs / INPUT_ONE
        x = np.concatenate([readings, wanted], 2)
        return torch.from_numpy(np.repeat(x, learning.steps_per_sample, 1))

    def one_epoch(self) -> ControlEpoch:
        """Train for an epoch, after the flights of its round, and let the student fly."""
        began, config, number = time.monotonic(), self.config, len(self.history)
        learning, round_ = config.learning, self.config.round_of(number)
        while len(self.rounds) <= round_:
            self.rounds.append(self._round(len(self.rounds)))
        flights = joined(self.rounds)
        first = number * learning.batches
        losses, rates = np.zeros(learning.batches), np.zeros((learning.batches, 2))
        seed = np.random.SeedSequence([config.seed, WINDOWS, number])
        epoch_windows = windows(flights, config, seed, learning.batch_size)
        for k in range(learning.batches):
            for group in self.optimiser.param_groups:
                group["lr"] = learning_rate(learning, first + k) * group["step"]
            losses[k], rates[k] = self._update(next(epoch_windows))
            if not math.isfinite(losses[k]):
                raise FloatingPointError(f"the loss is {losses[k]} at epoch {number}, update {k}")
        if not all(bool(p.isfinite().all()) for p in self.model.parameters()):
            raise FloatingPointError(f"the weights are not finite after epoch {number}")
        student = self.student()
        flown = self._fly_validation(student)
        return ControlEpoch(
            epoch=number,
            round=round_,
            updates=first + learning.batches,
            train_loss=float(np.mean(losses)),
            imitation=imitation_error(student, flown, config),
            tracking_deg=_tracking(flown),
            teacher_deg=self.teacher_deg,
            crashes=flown.crashes,
            rate_encoding=float(np.mean(rates[:, 0])),
            rate_hidden=float(np.mean(rates[:, 1])),
            learning_rate=learning_rate(learning, first + learning.batches - 1),
            seconds=(self.history[-1].seconds if self.history else 0.0) + time.monotonic() - began,
        )

    def _update(self, window: Window) -> tuple[float, list[float]]:
        """One step of the optimiser; the loss before it and the layers' spike rates."""
        learning, model = self.config.learning, self.model
        self._state[window.reset] = 0.0
        out, rates = model(self._inputs(window, self._state), window.reset)
        out = out[:, learning.steps_per_sample - 1 :: learning.steps_per_sample]
        target = torch.from_numpy(window.target)
        self.optimiser.zero_grad()
        error = attitude_loss(out / self._scale, target / self._scale, learning.huber_threshold)
        excess = (rates - torch.tensor(learning.rate_targets)).clamp(min=0.0).sum()
        (error + learning.rate_cost * excess).backward()
        if learning.clip > 0:
            torch.nn.utils.clip_grad_norm_(model.parameters(), learning.clip)
        self.optimiser.step()
        model.limit_currents()
        model.constrain()
        self.frozen.restore()
        return float(error.detach()), rates.tolist()

    def save_best(self, out: Path, epoch: ControlEpoch) -> None:
        """Write the slow weights as the run's best."""
        e0, e1 = self.estimator.sizes
        note = {
            "config": json.loads(self.config.model_dump_json()),
            "commit": commit(),
            "epoch": epoch.epoch + 1,
            "updates": epoch.updates,
            "flights": sum(map(len, self.rounds)),
            "vehicles": [self.recipe.vehicle.name],
            "estimator_neurons": [e0, e1],
            "tracking_deg": round(epoch.tracking_deg, 4),
            "teacher_deg": round(epoch.teacher_deg, 4),
            "crashes": epoch.crashes,
        }
        save_controller(out / "best.safetensors", self.exported(note))

    def checkpoint(self) -> dict[str, Any]:
        """What `restore` needs to continue."""
        history = [asdict(epoch) for epoch in self.history]
        return {
            "model": self.model.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "history": history,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a checkpoint."""
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.history = [ControlEpoch(**row) for row in state["history"]]


def _controller(weights: ControllerWeights) -> SpikingController:
    return SpikingController(weights.config, weights.tensors, reads=weights.reads)


def imitation_error(student: SpikingController, flights: ControlFlights, config: ControlConfig) -> float:
    """Root mean square error of the outputs on flights, over the error scale."""
    student.reset(len(flights))
    out = student.sequence(flights.set_point, flights.gyro, flights.accel)[..., :3]
    shift, steps = config.delay_shift, flights.gyro.shape[1]
    error = (out[:, : steps - shift] - flights.target[:, shift:]) / np.array(config.error_scale)
    valid = np.arange(steps - shift) < flights.end[:, None]
    return float(np.sqrt(np.mean(error[valid] ** 2))) if valid.any() else math.inf


def _tracking(flights: ControlFlights) -> float:
    """Root mean square over flights of the tracking error, crashed ones counted as `CRASH_DEG` [deg]."""
    crashed = flights.end < flights.gyro.shape[1]
    return float(np.sqrt(np.mean(np.where(crashed, CRASH_DEG, flights.error_deg) ** 2)))


def windows(
    flights: ControlFlights, config: ControlConfig, seed: np.random.SeedSequence, n: int
) -> Iterator[Window]:
    """Windows of n streams, without end: each starts anywhere in a flight and is cut into successive windows.

    Streams differ in length, log-uniform up to `windows_per_stream`; half of them start with their flight.
    """
    learning, rng = config.learning, np.random.default_rng(seed)
    steps, shift = round(learning.window_s * flights.rate_hz), config.delay_shift
    available = flights.end - shift
    if not np.any(available >= steps):
        raise ValueError("every flight ends within a window: give a smaller learning.window_s")
    place, left, row = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)
    while True:
        reset = left == 0
        for i in np.flatnonzero(reset):
            most = min(learning.windows_per_stream, int(available.max()) // steps)
            left[i] = int(math.exp(rng.uniform(0.0, math.log(most + 1))))
            while not np.any(available >= left[i] * steps):
                left[i] -= 1
            row[i] = rng.choice(np.flatnonzero(available >= left[i] * steps))
            latest = int(available[row[i]]) - left[i] * steps
            place[i] = 0 if rng.random() < 0.5 else rng.integers(latest + 1)
        index = row[:, None], place[:, None] + np.arange(steps)
        later = row[:, None], index[1] + shift
        yield Window(
            flights.gyro[index], flights.accel[index], flights.set_point[index], flights.target[later], reset
        )
        place += steps
        left -= 1


def save_flights(file: Path, flights: ControlFlights) -> None:
    """Write flights as an archive of arrays."""
    np.savez(buffer := io.BytesIO(), **asdict(flights))
    write_whole(file, buffer.getvalue())


def read_flights(file: Path) -> ControlFlights:
    """Read what `save_flights` wrote."""
    with np.load(file, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in (*SIGNALS, "end", "error_deg")}
        return ControlFlights(**arrays, rate_hz=float(stored["rate_hz"]))


def plot(out: Path, history: Sequence[ControlEpoch]) -> None:
    """Loss and tracking error over the epochs."""
    from matplotlib.figure import Figure

    left, right = (figure := Figure(figsize=(9, 4))).subplots(1, 2)
    epochs = [e.epoch + 1 for e in history]
    left.semilogy(epochs, [e.train_loss for e in history], label="training windows")
    left.semilogy(epochs, [e.imitation**2 for e in history], label="the student's flights")
    left.set(xlabel="epoch", ylabel="loss, over the error scale")
    right.plot(epochs, [e.tracking_deg for e in history], label="student")
    right.plot(epochs, [e.teacher_deg for e in history], label="teacher")
    right.set(xlabel="epoch", ylabel="RMS tracking error [°], crashes as 90°", ylim=(0, None))
    for axes in (left, right):
        axes.legend()
        axes.grid(alpha=0.3)
    save_figure(out / "curve.png", figure, dpi=150, bbox_inches="tight")
