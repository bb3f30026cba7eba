"""The training loop: epochs of updates, validation and checkpoints.

The folder of a run contains `config.json`, `contents.json` (digests of its inputs), `log.csv` (a row per
epoch), `checkpoint.pt`, `best.safetensors`, `curve.png` and, for a controller, the flights of each round. A
run that was stopped continues from its checkpoint and ends with the same weights.
"""

from __future__ import annotations

import io
import json
import logging
import math
import pickle
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from estimators.networks.encoder import ENCODER
from estimators.networks.weights_file import NetworkConfig, Tensors, save_network
from quadsim.dataset.store import Progress as FlightsProgress
from quadsim.runs.files import alone, write_csv, write_whole
from quadsim.runs.record import commit

from .config import CircuitRun, TrainConfig, make_config
from .data import AttitudeTask, Batch, network_inputs
from .models import AttSNN
from .optim import error_loss, finished, learning_rate, new_optimiser, total_cost
from .run_folder import Epoch, claim, plot_history

if TYPE_CHECKING:
    from .circuit.train import CircuitLearner
    from .control.task import ControlTask

log = logging.getLogger(__name__)

DIVERGED = "training diverged"
"""Start of the reason if a run ended because the loss or the weights were not finite."""
INTERRUPTED = "interrupted"
"""Reason if Ctrl-C ended a run; the same command continues it."""

Config = TrainConfig | CircuitRun
Progress = Callable[[Epoch, Config], None]
Student = Callable[[], tuple[NetworkConfig, Tensors]]
"""The network in training."""


def learner_of(config: Config, out: Path) -> Training | CircuitLearner:
    """Return the learner of a run in a folder, with its datasets loaded."""
    if isinstance(config, CircuitRun):
        from .circuit.train import CircuitLearner

        return CircuitLearner(config)
    if not config.controls:
        return Training(config, AttitudeTask(config))
    from .control.task import ControlTask  # needs the simulator, which takes a second

    return Training(config, ControlTask(config, out))


@dataclass(frozen=True)
class Result:
    """Result of a run."""

    weights: Path
    """File of the best epoch's weights."""
    best: Epoch
    reason: str
    """Reason for the end of the run."""


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
        model: "att-snn" or "att-rnn", for networks of layers.
        data: One or several datasets. A controller, or a circuit whose preset defines flights, needs none.
        out: Folder for the results.
        preset: Name of a shipped preset, or a TOML file.
        progress: Called after every epoch.
        choices: Fields of `TrainConfig` or `CircuitRun` that replace those of the preset.

    Raises:
        ValueError: A choice or a dataset is invalid, or `out` contains another run.
        FileNotFoundError: A dataset or a weights file does not exist.
    """
    return train_epochs(make_config(preset, model=model, data=data, **choices), Path(out), progress)


def train_epochs(
    config: Config,
    out: Path,
    progress: Progress | None = None,
    generated: FlightsProgress = lambda done, total: None,
) -> Result:
    """Train with a complete configuration; `generated` is called while flights are generated."""
    with alone(out):
        if isinstance(config, CircuitRun) and not config.data:
            from .circuit.flight_sets import own_flights

            config = own_flights(config, out / "flights", generated)
        learner = learner_of(config, out)
        claim(out, config, learner.contents())
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # the result must not depend on the machine's number of cores
        try:
            learner.begin()
            history = _restored(learner, out)
            reason = _all_epochs(config, learner, history, out, progress)
        finally:
            torch.set_num_threads(threads)
        if not history:
            raise ValueError(f"{out}: stopped before the first epoch was over ({reason}), nothing to save")
        plot_history(out, history)
        return Result(out / "best.safetensors", _best(config, history), reason)


def _restored(learner: Training | CircuitLearner, out: Path) -> list[Epoch]:
    """Continue from a checkpoint, if there is one, and return the finished epochs.

    Raises:
        ValueError: The checkpoint is damaged or of another version, or the weights are missing.
    """
    if not (out / "checkpoint.pt").is_file():
        return []
    if not (out / "best.safetensors").is_file():
        raise ValueError(f"{out}: best.safetensors is missing beside its checkpoint, choose another folder")
    try:
        state = torch.load(out / "checkpoint.pt", weights_only=True)
        learner.load_state_dict(state)
        return [Epoch(**row) for row in state["history"]]
    except (RuntimeError, KeyError, TypeError, EOFError, pickle.UnpicklingError) as error:
        text = "its checkpoint is damaged or of another version of quadsim, choose another folder"
        raise ValueError(f"{out}: {text}") from error


def _best(config: Config, history: list[Epoch]) -> Epoch:
    """Return the epoch whose weights are kept; for a circuit, the last one."""
    return history[-1] if isinstance(config, CircuitRun) else min(history, key=Epoch.rank)


def _all_epochs(
    config: Config,
    learner: Training | CircuitLearner,
    history: list[Epoch],
    out: Path,
    progress: Progress | None,
) -> str:
    """Train, validate and save until the run ends; return the reason."""
    stops = isinstance(config, TrainConfig) and config.method.stop_early
    try:
        while len(history) < config.epochs:
            if stops and (reason := finished([e.score for e in history])):
                return reason
            began, before = time.monotonic(), history[-1].seconds if history else 0.0
            epoch = learner.one_epoch(len(history))
            epoch = replace(epoch, seconds=before + time.monotonic() - began)
            history.append(epoch)
            if _best(config, history) is epoch:
                about = {"config": json.loads(config.model_dump_json()), "commit": commit()}
                about |= {"epoch": epoch.epoch + 1, "updates": epoch.updates}
                about |= {f"validation_{name}": round(value, 6) for name, value in epoch.validation.items()}
                learner.save(out / "best.safetensors", about)
            # by way of memory: PyTorch reports a full disk as a failed writer
            state = learner.state_dict() | {"history": list(map(asdict, history))}
            torch.save(state, buffer := io.BytesIO())
            write_whole(out / "checkpoint.pt", buffer.getvalue())
            write_csv(out / "log.csv", [each.row() for each in history])
            if progress:
                progress(epoch, config)
    except KeyboardInterrupt:
        return INTERRUPTED
    except FloatingPointError as error:
        log.error("%s: training stopped, the best weights so far stay", error)
        return f"{DIVERGED}: {error}"
    return f"all {config.epochs} epochs done"


class Training:
    """Training of a network of layers on a task."""

    def __init__(self, config: TrainConfig, task: AttitudeTask | ControlTask) -> None:
        self.config, self.task, self.contents = config, task, task.contents
        self._input_state = np.zeros(config.batch_size, ENCODER)
        self._scale = torch.tensor(task.scale)

    def begin(self) -> None:
        """Make the initial network and the optimiser."""
        torch.manual_seed(self.config.seed)
        self.model = self.task.initial_model()
        self.optimiser = new_optimiser(self.model, self.config)

    def exported(self, note: dict[str, Any] | None = None) -> tuple[NetworkConfig, Tensors]:
        """Return the slow weights in the format of estimators and controllers."""
        with self.optimiser.evaluated():
            fields = {"rate_hz": self.task.rate_hz, "training": note or {}}
            return self.model.network.model_copy(update=fields), self.model.tensors()

    def one_epoch(self, number: int) -> Epoch:
        """Train for an epoch, counted from 0, and validate the slow weights."""
        config = self.config
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
            learning_rate=learning_rate(config, first + config.batches - 1),
            figures=dict(zip(("rate_encoding", "rate_hidden"), map(float, rates.mean(0)), strict=True)),
            validation=self.task.validate(*self.exported()),
        )

    def _update(self, batch: Batch) -> tuple[float, list[float]]:
        """Run one step of the optimiser; return the previous mean square error and spike rates."""
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

    def save(self, file: Path, note: dict[str, Any]) -> None:
        """Write the slow weights; `note` is stored in the file."""
        save_network(file, *self.exported(note | self.task.note()))

    def state_dict(self) -> dict[str, Any]:
        """Everything that a resumed run needs."""
        return {"model": self.model.state_dict(), "optimiser": self.optimiser.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from the result of `state_dict`."""
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
