"""The training loop: data, model, epochs of windows, validation on complete flights, checkpoints.

A run's folder holds `config.json`, `log.csv` (a row per epoch), `checkpoint.pt`, `best.safetensors` and
`curve.png`. A run that was stopped continues from its checkpoint and ends with the same weights.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from estimators.metrics import absolute_error, inclination_error
from estimators.networks.encoder import ENCODER
from estimators.networks.network import NetworkEstimator, Recurrent, Spiking
from quadsim.runs.files import alone

from .config import TrainConfig, make_config
from .data import Batch, TrainingFlights, flights_of, network_inputs, sample_windows, target_of, windows
from .init import initial_model, reinitialise_dead_neurons
from .loss import attitude_loss, finished, total_cost
from .models import AttRNN, AttSNN, prune_connections
from .optim import learning_rate, new_optimiser, resized_state
from .run_folder import Epoch, claim, contents_of, exported, plot, save_best, save_checkpoint, write_log

log = logging.getLogger(__name__)

PRUNE_EVERY = 60
"""Updates between two prunings; an epoch's last update prunes too."""
SETTLED_S = 5.0
"""Time after an unknown initial attitude that `val_settled_deg` leaves out [s]."""
DIVERGED = "training diverged"
"""Beginning of the reason of a run that ended at a loss or weights that are not finite."""
INTERRUPTED = "interrupted"
"""Reason of a run that Ctrl-C ended; the same command continues it."""

Progress = Callable[[Epoch, TrainConfig], None]


@dataclass(frozen=True)
class Result:
    """How a run ended."""

    weights: Path
    """File of the best epoch's weights."""
    best: Epoch
    reason: str
    """Why it ended."""
    before: float | None = None
    """Mean square error on the validation flights of the weights that it continued from [rad²]."""

    @property
    def helped(self) -> bool:
        """Whether the validation loss is below that of those weights."""
        return self.before is None or self.best.val_mse < self.before


def train(
    model: str = "att-snn",
    data: str | Path | tuple[str, ...] = (),
    out: str | Path = "runs/att-snn",
    preset: str | Path = "paper",
    progress: Progress | None = None,
    **choices: Any,
) -> Result:
    """Train a network, or continue a run that was stopped.

    Args:
        model: "att-snn" or "att-rnn".
        data: One dataset or several.
        out: Folder of the run.
        preset: Name of a shipped preset, or a TOML file.
        progress: Called after every epoch.
        choices: Fields of `TrainConfig` that differ from the preset.

    Raises:
        ValueError: A bad choice or dataset, or another run's folder.
        FileNotFoundError: A dataset is not there.
    """
    return run(make_config(preset, model=model, data=data, **choices), Path(out), progress)


def run(config: TrainConfig, out: Path, progress: Progress | None = None) -> Result:
    """As `train`, from a complete configuration."""
    with alone(out):
        return _run(config, out, progress)


def _run(config: TrainConfig, out: Path, progress: Progress | None) -> Result:
    flights, validation, _ = flights_of(config)
    threads = torch.get_num_threads()
    torch.set_num_threads(config.threads)  # the result must not depend on the machine's number of cores
    try:
        training = Training(config, flights, validation)
        claim(out, config, contents_of(config, flights, validation))
        before = training.validate()[0] if config.init else None
        if (out / "checkpoint.pt").is_file():
            try:
                training.restore(torch.load(out / "checkpoint.pt", weights_only=True))
            except (RuntimeError, KeyError, TypeError) as error:
                text = "its checkpoint is of another version of quadsim, choose another folder"
                raise ValueError(f"{out}: {text}") from error
        reason = _all_epochs(training, out, progress)
    finally:
        torch.set_num_threads(threads)
    if not training.history:
        raise ValueError(f"{out}: stopped before the first epoch was over ({reason}), nothing to save")
    plot(out, training.history)
    return Result(out / "best.safetensors", min(training.history, key=training.rank), reason, before)


def _all_epochs(training: Training, out: Path, progress: Progress | None) -> str:
    """Train, validate and save until something ends the run; the reason."""
    config, history = training.config, training.history
    try:
        while len(history) < config.epochs:
            pruned = not config.prunes or training.model.parameter_count <= config.pruning_target
            if config.stop_early and pruned and (reason := finished([e.val_mse for e in history])):
                return reason
            epoch = training.one_epoch()
            history.append(epoch)
            if training.rank(epoch) <= min(map(training.rank, history)):
                training.save_best(out, epoch)
            save_checkpoint(out, training.checkpoint())
            write_log(out, history)
            if progress:
                progress(epoch, config)
    except KeyboardInterrupt:
        return INTERRUPTED
    except FloatingPointError as error:
        log.error("%s: training stopped, the best weights so far stay", error)
        return f"{DIVERGED}: {error}"
    return f"all {config.epochs} epochs done"


class Training:
    """A run in memory: the model, its optimiser and the epochs so far, which a checkpoint saves."""

    def __init__(self, config: TrainConfig, flights: TrainingFlights, validation: TrainingFlights) -> None:
        self.config, self.flights, self.validation = config, flights, validation
        self.model: AttSNN | AttRNN = initial_model(config, flights, self._steps_in(0))
        self.optimiser = new_optimiser(self.model, config)
        self.history: list[Epoch] = []
        self._input_state = np.zeros(config.batch_size, ENCODER)
        self._unpruned = self.model.parameter_count

    def _steps_in(self, epoch: int) -> int:
        """Samples of a window of an epoch."""
        return round(self.config.window_s_in(epoch) * self.flights.rate_hz)

    def one_epoch(self) -> Epoch:
        """Train for an epoch and validate the slow weights."""
        began, config, number = time.monotonic(), self.config, len(self.history)
        first = number * config.batches
        if isinstance(self.model, AttSNN) and number < config.reinitialise_until * config.epochs:
            self._reinitialise(self.model, number)
        squares, rates = np.zeros(config.batches), np.zeros((config.batches, 2))
        epoch_windows = windows(self.flights, config, self._steps_in(number), (config.seed, 1, number))
        for k, batch in enumerate(epoch_windows):
            for group in self.optimiser.param_groups:
                group["lr"] = learning_rate(config, first + k) * group["step"]
            squares[k], rates[k] = self._update(batch)
            if not math.isfinite(squares[k]):
                raise FloatingPointError(f"the loss is {squares[k]} at epoch {number}, update {k}")
            if config.prunes and (k % PRUNE_EVERY == PRUNE_EVERY - 1 or k == config.batches - 1):
                self._prune(first + k + 1)
        if not all(bool(p.isfinite().all()) for p in self.model.parameters()):
            raise FloatingPointError(f"the weights are not finite after epoch {number}")
        mse, error, settled, inclination = self.validate()
        return Epoch(
            epoch=number,
            updates=first + config.batches,
            train_rmse_deg=math.degrees(math.sqrt(np.mean(squares))),
            val_mse=mse,
            val_error_deg=error,
            val_settled_deg=settled,
            val_inclination_deg=inclination,
            rate_encoding=float(np.mean(rates[:, 0])),
            rate_hidden=float(np.mean(rates[:, 1])),
            learning_rate=learning_rate(config, first + config.batches - 1),
            parameters=self.model.parameter_count,
            seconds=(self.history[-1].seconds if self.history else 0.0) + time.monotonic() - began,
        )

    def _update(self, batch: Batch) -> tuple[float, list[float]]:
        """One step of the optimiser; the mean square error before it [rad²] and the layers' spike rates."""
        config, model = self.config, self.model
        self._input_state[batch.reset] = 0.0
        x = network_inputs(config, batch, self._input_state)
        estimate, rates = model(x, batch.reset)
        estimate = estimate[:, config.steps_per_sample - 1 :: config.steps_per_sample]
        target = torch.from_numpy(target_of(config, batch))
        self.optimiser.zero_grad()
        total_cost(estimate, target, rates, config).backward()
        if config.clip > 0:
            torch.nn.utils.clip_grad_norm_(model.parameters(), config.clip)
        self.optimiser.step()
        if isinstance(model, AttSNN):
            model.limit_currents()
        model.constrain()
        return float(attitude_loss(estimate.detach(), target)), rates.tolist()

    def _reinitialise(self, model: AttSNN, number: int) -> None:
        seed = (self.config.seed, 2, number)
        x, _ = sample_windows(self.config, self.flights, self._steps_in(number), seed)
        if count := reinitialise_dead_neurons(model, x, self.config.seed + number):
            self.optimiser.restart()
            log.info("epoch %d begins with %d hidden neurons re-initialised", number + 1, count)

    def _prune(self, updates: int) -> None:
        """Prune to the target of this update: the excess falls as the cube of the remaining time."""
        model, config, (start, end) = self.model, self.config, self.config.pruning_span
        assert isinstance(model, AttSNN)
        share = np.clip((updates / (config.epochs * config.batches) - start) / (end - start), 0.0, 1.0)
        most = config.pruning_target + round((self._unpruned - config.pruning_target) * (1 - share) ** 3)
        if model.parameter_count <= most:
            return
        moments = self.optimiser.optimizer.state
        prune_connections(model, {w: moments[getattr(model, w)]["exp_avg_sq"] for w in model.matrices}, most)
        neurons = model.connected_neurons
        names = [name for name, _ in model.named_parameters()]

        def resized(k: int, value: Tensor) -> Tensor:
            connected = getattr(model, f"{names[k]}_connected", None)
            return model.select(names[k], value if connected is None else value * connected, neurons)

        state = resized_state(self.optimiser.state_dict(), resized)
        self.model = model.subset(neurons)
        self.optimiser = new_optimiser(self.model, config)
        self.optimiser.load_state_dict(state)

    def validate(self) -> tuple[float, float, float, float]:
        """Mean square error [rad²], mean absolute error, the same once settled and inclination RMSE [deg]."""
        with self.optimiser.evaluated():
            config, tensors = exported(self.model, self.config, self.flights.rate_hz, {})
        core = Spiking(config, tensors) if config.model == "att-snn" else Recurrent(config, tensors)
        estimator = NetworkEstimator(core, config.rate_hz)
        flights, truth = self.validation, self.validation.roll_pitch
        estimator.reset(len(flights))
        estimate = estimator.sequence(flights.gyro, flights.accel)
        error = absolute_error(estimate, truth)
        settled = error[:, round(SETTLED_S * flights.rate_hz) :]
        degrees = [float(e.mean()) for e in (error, settled if settled.size else error)]
        inclination = float(np.sqrt(np.mean(inclination_error(estimate, truth) ** 2)))
        up = config.outputs == "up"
        mse = math.radians(inclination) ** 2 / 2 if up else float(np.mean((estimate - truth) ** 2))
        return mse, degrees[0], degrees[1], inclination

    def rank(self, epoch: Epoch) -> tuple[int, float]:
        """The best epoch has the least: parameters above the pruning target, then validation loss."""
        target = self.config.pruning_target
        loss = epoch.val_mse if math.isfinite(epoch.val_mse) else math.inf
        return (max(epoch.parameters, target) if self.config.prunes else 0, loss)

    def save_best(self, out: Path, epoch: Epoch) -> None:
        """Write the slow weights as the run's best."""
        flights, error = len(self.validation), round(epoch.val_error_deg, 4)
        note = {"epoch": epoch.epoch + 1, "updates": epoch.updates}
        note |= {"validation_flights": flights, "validation_error_deg": error}
        if self.config.outputs == "up":
            note["validation_inclination_deg"] = round(epoch.val_inclination_deg, 4)
        with self.optimiser.evaluated():
            save_best(out, self.model, self.config, self.flights, note)

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
        if isinstance(self.model, AttSNN):  # it may have been pruned
            self.model = self.model.subset([np.arange(n) for n in state["model"]["w_ff"].shape[::-1]])
        self.model.load_state_dict(state["model"])
        self.optimiser = new_optimiser(self.model, self.config)
        self.optimiser.load_state_dict(state["optimiser"])
        self.history = [Epoch(**row) for row in state["history"]]
