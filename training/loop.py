"""The training loop: epochs of windows, validation, checkpoints.

A run's folder holds `config.json`, `log.csv` (a row per epoch), `checkpoint.pt`, `best.safetensors`,
`curve.png` and, of a controller, the flights of each round. A run that was stopped continues from its
checkpoint and ends with the same weights.
"""

from __future__ import annotations

import io
import json
import logging
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from estimators.networks.encoder import ENCODER
from estimators.networks.weights_file import NetworkConfig, Tensors, save_network
from quadsim.runs.files import alone, write_csv, write_whole
from quadsim.runs.record import commit

from .config import TrainConfig, make_config
from .data import AttitudeTask, Batch, network_inputs
from .models import AttRNN, AttSNN
from .optim import error_loss, finished, learning_rate, new_optimiser, total_cost
from .run_folder import Epoch, claim, contents_of, plot

log = logging.getLogger(__name__)

DIVERGED = "training diverged"
"""Beginning of the reason of a run that ended at a loss or weights that are not finite."""
INTERRUPTED = "interrupted"
"""Reason of a run that Ctrl-C ended; the same command continues it."""

Progress = Callable[[Epoch, TrainConfig], None]
Student = Callable[[], tuple[NetworkConfig, Tensors]]
"""The network so far."""


class Task(Protocol):
    """What a network learns: flights, inputs and targets, and how it is judged."""

    rate_hz: float
    """Samples per second."""
    scale: tuple[float, ...]
    """Errors of the outputs that weigh the same in the loss."""

    def contents(self) -> dict[str, str]:
        """Digests of the flights, so that a run on others is refused."""
        ...

    def initial_model(self) -> AttSNN | AttRNN:
        """The network before the first update."""
        ...

    def windows(self, epoch: int, student: Student) -> Iterator[Batch]:
        """The windows of an epoch, counted from 0."""
        ...

    def validate(self, network: NetworkConfig, tensors: Tensors) -> dict[str, float]:
        """Figures of merit by name; the first chooses the best epoch, the least is best."""
        ...

    def note(self) -> dict[str, Any]:
        """What the weights say of the flights."""
        ...


def task_of(config: TrainConfig, out: Path) -> Task:
    """The task of a run in a folder.

    Raises:
        ValueError: A dataset that cannot be used.
        FileNotFoundError: A dataset is not there.
    """
    if not config.controls:
        return AttitudeTask(config)
    from .control.task import ControlTask  # needs the simulator, which takes a second

    return ControlTask(config, out)


@dataclass(frozen=True)
class Result:
    """How a run ended."""

    weights: Path
    """File of the best epoch's weights."""
    best: Epoch
    reason: str
    """Why it ended."""


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
        data: One dataset or several; none for a controller.
        out: Folder of the run.
        preset: Name of a shipped preset, or a TOML file.
        progress: Called after every epoch.
        choices: Fields of `TrainConfig` that differ from the preset.

    Raises:
        ValueError: A bad choice or dataset, or another run's folder.
        FileNotFoundError: A dataset, or weights, are not there.
    """
    return run(make_config(preset, model=model, data=data, **choices), Path(out), progress)


def run(config: TrainConfig, out: Path, progress: Progress | None = None) -> Result:
    """As `train`, from a complete configuration."""
    with alone(out):
        task = task_of(config, out)
        claim(out, config, contents_of(config, task.contents()))
        threads = torch.get_num_threads()
        torch.set_num_threads(config.threads)  # the result must not depend on the machine's number of cores
        try:
            training = Training(config, task)
            if (out / "checkpoint.pt").is_file():
                training.restore(out)
            reason = _all_epochs(training, out, progress)
        finally:
            torch.set_num_threads(threads)
        if not training.history:
            raise ValueError(f"{out}: stopped before the first epoch was over ({reason}), nothing to save")
        plot(out, training.history)
        return Result(out / "best.safetensors", min(training.history, key=Epoch.rank), reason)


def _all_epochs(training: Training, out: Path, progress: Progress | None) -> str:
    """Train, validate and save until something ends the run; the reason."""
    config, history = training.config, training.history
    try:
        while len(history) < config.epochs:
            if config.method.stop_early and (reason := finished([e.score for e in history])):
                return reason
            epoch = training.one_epoch()
            history.append(epoch)
            if epoch.rank() <= min(map(Epoch.rank, history)):
                training.save_best(out, epoch)
            training.save_checkpoint(out)
            write_csv(out / "log.csv", [each.row() for each in history])
            if progress:
                progress(epoch, config)
    except KeyboardInterrupt:
        return INTERRUPTED
    except FloatingPointError as error:
        log.error("%s: training stopped, the best weights so far stay", error)
        return f"{DIVERGED}: {error}"
    return f"all {config.epochs} epochs done"


def exported(model: AttSNN | AttRNN, rate_hz: float, note: dict[str, Any]) -> tuple[NetworkConfig, Tensors]:
    """The network as it is run: its configuration and tensors for `save_network`."""
    fields = {"rate_hz": rate_hz, "output_scale": model.output_scale, "training": note}
    return model.network.model_copy(update=fields), model.tensors()


class Training:
    """A run in memory: the model, its optimiser and the epochs so far, which a checkpoint saves."""

    def __init__(self, config: TrainConfig, task: Task) -> None:
        self.config, self.task = config, task
        torch.manual_seed(config.seed)
        self.model = task.initial_model()
        self.optimiser = new_optimiser(self.model, config)
        self.history: list[Epoch] = []
        self._input_state = np.zeros(config.batch_size, ENCODER)
        self._scale = torch.tensor(task.scale)

    def exported(self, note: dict[str, Any] | None = None) -> tuple[NetworkConfig, Tensors]:
        """The slow weights as an estimator, or a controller, runs them."""
        with self.optimiser.evaluated():
            return exported(self.model, self.task.rate_hz, note or {})

    def one_epoch(self) -> Epoch:
        """Train for an epoch and validate the slow weights."""
        began, config, number = time.monotonic(), self.config, len(self.history)
        first = number * config.batches
        losses, rates = np.zeros(config.batches), np.zeros((config.batches, 2))
        for k, batch in enumerate(self.task.windows(number, self.exported)):
            for group in self.optimiser.param_groups:
                group["lr"] = learning_rate(config, first + k) * group["step"]
            losses[k], rates[k] = self._update(batch)
            if not math.isfinite(losses[k]):
                raise FloatingPointError(f"the loss is {losses[k]} at epoch {number}, update {k}")
        if not all(bool(p.isfinite().all()) for p in self.model.parameters()):
            raise FloatingPointError(f"the weights are not finite after epoch {number}")
        return Epoch(
            epoch=number,
            updates=first + config.batches,
            train_loss=float(np.mean(losses)),
            rate_encoding=float(np.mean(rates[:, 0])),
            rate_hidden=float(np.mean(rates[:, 1])),
            learning_rate=learning_rate(config, first + config.batches - 1),
            validation=self.task.validate(*self.exported()),
            seconds=(self.history[-1].seconds if self.history else 0.0) + time.monotonic() - began,
        )

    def _update(self, batch: Batch) -> tuple[float, list[float]]:
        """One step of the optimiser; the mean square error before it and the layers' spike rates."""
        config, model = self.config, self.model
        self._input_state[batch.reset] = 0.0
        outputs, rates = model(network_inputs(config, batch, self._input_state), batch.reset)
        target = torch.from_numpy(batch.target) / self._scale
        self.optimiser.zero_grad()
        total_cost(outputs / self._scale, target, rates, config).backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), config.method.clip)
        self.optimiser.step()
        if isinstance(model, AttSNN):
            model.limit_currents()
        model.constrain()
        return float(error_loss(outputs.detach() / self._scale, target)), rates.tolist()

    def save_best(self, out: Path, epoch: Epoch) -> None:
        """Write the slow weights as the run's best."""
        config = {"config": json.loads(self.config.model_dump_json()), "commit": commit()}
        figures = {f"validation_{name}": round(value, 6) for name, value in epoch.validation.items()}
        progress = {"epoch": epoch.epoch + 1, "updates": epoch.updates}
        network, tensors = self.exported(config | self.task.note() | progress | figures)
        save_network(out / "best.safetensors", network, tensors)

    def save_checkpoint(self, out: Path) -> None:
        """Write what `restore` needs, by way of memory: PyTorch reports a full disk as a failed writer."""
        history = [asdict(epoch) for epoch in self.history]
        state = {"model": self.model.state_dict(), "optimiser": self.optimiser.state_dict()}
        torch.save(state | {"history": history}, buffer := io.BytesIO())
        write_whole(out / "checkpoint.pt", buffer.getvalue())

    def restore(self, out: Path) -> None:
        """Continue from a folder's checkpoint.

        Raises:
            ValueError: One of another version.
        """
        try:
            state = torch.load(out / "checkpoint.pt", weights_only=True)
            self.model.load_state_dict(state["model"])
            self.optimiser.load_state_dict(state["optimiser"])
            self.history = [Epoch(**row) for row in state["history"]]
        except (RuntimeError, KeyError, TypeError) as error:
            text = "its checkpoint is of another version of quadsim, choose another folder"
            raise ValueError(f"{out}: {text}") from error
