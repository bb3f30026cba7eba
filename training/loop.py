"""The training loop: epochs of windows, validation on whole flights, checkpoints, and the weights file.

A run's folder holds `config.json`, `log.csv` (a row per epoch), `checkpoint.pt`, `best.safetensors` and
`curve.png`. A run that was stopped goes on from its checkpoint and ends with the same weights.
"""

from __future__ import annotations

import io
import json
import logging
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from estimators.analysis.ablation import connected
from estimators.networks.encoder import ENCODER, scaled_inputs
from estimators.networks.network import NetworkEstimator, Recurrent, Spiking
from estimators.networks.symmetry import OPERATIONS
from estimators.networks.weights_file import NetworkConfig, Tensors, load_network, save_network
from estimators.spiking import MATRICES
from quadsim.runs.files import write_whole

from .config import TrainConfig, make_config
from .data import Batch, Flights, fold_split, load_flights, split, windows
from .init import revive, start_from_data, start_from_weights, start_like_the_paper
from .loss import attitude_loss, finished, rate_cost
from .models import AttRNN, AttSNN, thin
from .optim import Lookahead, changed
from .run_folder import Epoch, claim, commit, contents_of, plot, write_log

log = logging.getLogger(__name__)

Model = AttSNN | AttRNN

THIN_EVERY = 60
"""Updates between two times that connections are taken away; they are also at an epoch's end."""
INTERRUPTED = "interrupted"
"""Why a run ended that Ctrl-C stopped; it goes on where it was."""


@dataclass(frozen=True)
class Result:
    """How a run ended."""

    weights: Path
    """File of the best epoch's weights."""
    best: Epoch
    reason: str
    """Why it ended."""
    before: float | None = None
    """Mean square error on the validation flights of the weights that it went on from [rad²]."""

    @property
    def helped(self) -> bool:
        """Whether the validation loss is below that of those weights."""
        return self.before is None or self.best.val_mse < self.before


Progress = Callable[[Epoch, TrainConfig], None]


class _Run:
    """The state of a run in memory: what a checkpoint saves."""

    def __init__(self, config: TrainConfig, flights: Flights, validation: Flights) -> None:
        self.config, self.flights, self.validation = config, flights, validation
        self.steps = round(config.window_s * flights.rate_hz)
        model = _new_model(config)
        _start(model, config, flights, self.steps)
        self._take(model)
        self.history: list[Epoch] = []
        self._input_state = np.zeros(config.batch_size, ENCODER)
        self._whole = _size(self.model)

    def _take(self, model: Model, state: dict[str, Any] | None = None) -> None:
        """Train this model, its optimiser in this state or at rest."""
        config, self.model = self.config, model
        for name, parameter in model.named_parameters():
            parameter.requires_grad_(config.train_decays or not name.startswith(("syn", "mem")))
        groups = [
            {"params": [parameter], "step": _step(config, name)}
            for name, parameter in model.named_parameters()
        ]
        adam = torch.optim.Adam(groups, lr=config.optimiser_lr, betas=(0.9, config.adam_beta2))
        self.optimiser = Lookahead(adam, config.lookahead_k, config.lookahead_alpha)
        if state:
            self.optimiser.load_state_dict(state)

    def one_epoch(self) -> Epoch:
        """Train for an epoch and validate the slow weights."""
        began, config, number = time.monotonic(), self.config, len(self.history)
        if isinstance(self.model, AttSNN) and number < config.revive * config.epochs:
            self._revive(number)
        squares, rates = [], []
        rate = _learning_rate(config, number * config.batches)
        batches = windows(
            self.flights, config.augmentation, config.batches, config.batch_size, self.steps,
            config.windows_per_stream, (config.seed, 1, number),
        )  # fmt: skip
        for k, batch in enumerate(batches):
            rate = _learning_rate(config, number * config.batches + k)
            for group in self.optimiser.param_groups:
                group["lr"] = rate * group["step"]
            square, spikes = self._update(batch)
            if not math.isfinite(square):
                raise FloatingPointError(f"the loss is {square} at epoch {number}, update {k}")
            squares.append(square)
            rates.append(spikes)
            if config.thinned and (k % THIN_EVERY == THIN_EVERY - 1 or k == config.batches - 1):
                self._thin(number * config.batches + k + 1)
        if not all(bool(p.isfinite().all()) for p in self.model.parameters()):
            raise FloatingPointError(f"the weights are not finite after epoch {number}")
        mse, error, settled = self.validate()
        return Epoch(
            epoch=number,
            updates=(number + 1) * config.batches,
            train_rmse_deg=math.degrees(math.sqrt(np.mean(squares))),
            val_mse=mse,
            val_error_deg=error,
            val_settled_deg=settled,
            rate_encoding=float(np.mean([r[0] for r in rates])),
            rate_hidden=float(np.mean([r[1] for r in rates])),
            learning_rate=rate,
            parameters=_size(self.model),
            seconds=(self.history[-1].seconds if self.history else 0.0) + time.monotonic() - began,
        )

    def _revive(self, number: int) -> None:
        x, _ = _sample(self.config, self.flights, self.steps, (self.config.seed, 2, number))
        assert isinstance(self.model, AttSNN)
        if found := revive(self.model, x, self.config.seed + number):
            self.optimiser.restart()
            log.info("epoch %d begins with %d hidden neurons that were idle", number + 1, found)

    def _thin(self, updates: int) -> None:
        """Take away connections, fewer the fewer are left: the excess falls as the cube of the time left."""
        assert isinstance(self.model, AttSNN)
        config, (start, end) = self.config, self.config.thinning
        done = np.clip((updates / (config.epochs * config.batches) - start) / (end - start), 0.0, 1.0)
        wanted = config.parameters
        most = wanted + round((self._whole - wanted) * (1 - done) ** 3)
        if self.model.parameters_kept > most:
            state = self.optimiser.optimizer.state
            squares = {name: state[getattr(self.model, name)]["exp_avg_sq"] for name in MATRICES}
            thin(self.model, squares, most)
            self._leave_out()

    def _leave_out(self) -> None:
        """Forget connections that were taken away, and neurons that nothing joins to inputs and outputs."""
        assert isinstance(self.model, AttSNN)
        model, neurons = self.model, self.model.living
        names = [name for name, _ in model.named_parameters()]

        def change(k: int, value: Tensor) -> Tensor:
            kept = model.kept.get(getattr(model, names[k]))
            return model.part(names[k], value if kept is None else value * kept, neurons)

        self._take(model.without(neurons), changed(self.optimiser.state_dict(), change))

    def _update(self, batch: Batch) -> tuple[float, list[float]]:
        config = self.config
        self._input_state[batch.fresh] = 0.0
        x = _inputs(config, batch, self._input_state)
        estimate, rates = self.model(x, batch.fresh)
        estimate = estimate[:, config.steps_per_sample - 1 :: config.steps_per_sample]
        wanted = torch.from_numpy(batch.roll_pitch)
        cost = attitude_loss(estimate, wanted, config.knee) + config.rate_cost * rate_cost(
            rates, torch.tensor(config.rate_targets)
        )
        self.optimiser.zero_grad()
        cost.backward()
        if config.clip > 0:
            torch.nn.utils.clip_grad_norm_(self.model.parameters(), config.clip)
        self.optimiser.step()
        if isinstance(self.model, AttSNN):
            self.model.stay_in_range()
        self.model.constrain()
        return float(attitude_loss(estimate.detach(), wanted)), rates.tolist()

    def validate(self) -> tuple[float, float, float]:
        """Mean square error [rad²], mean absolute error and the same once settled [deg]."""
        estimate = self.estimator().sequence(self.validation.gyro, self.validation.accel)
        error = estimate - self.validation.roll_pitch
        late = round(5.0 * self.validation.rate_hz)
        settled = error[:, late:] if error.shape[1] > late else error
        mean, mean_settled = (float(np.degrees(np.abs(e).mean())) for e in (error, settled))
        return float(np.mean(error**2)), mean, mean_settled

    def estimator(self) -> NetworkEstimator:
        """The slow weights, flown as the estimator that will ship."""
        with self.optimiser.evaluated():
            config, tensors = exported(self.model, self.config, self.flights.rate_hz, {})
        core = Spiking(config, tensors) if config.model == "att-snn" else Recurrent(config, tensors)
        est = NetworkEstimator(core, config.rate_hz)
        est.reset(len(self.validation))
        return est

    def checkpoint(self) -> dict[str, Any]:
        return {
            "model": self.model.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "history": [asdict(epoch) for epoch in self.history],
        }

    def restore(self, state: dict[str, Any]) -> None:
        model = self.model
        if isinstance(model, AttSNN):  # neurons may have left
            model = model.without([np.arange(n) for n in state["model"]["w_ff"].shape[::-1]])
        model.load_state_dict(state["model"])
        self._take(model, state["optimiser"])
        self.history = [Epoch(**row) for row in state["history"]]


def train(
    model: str = "att-snn",
    data: str | Path | tuple[str, ...] = (),
    out: str | Path = "runs/att-snn",
    preset: str = "paper",
    progress: Progress | None = None,
    **choices: Any,
) -> Result:
    """Train a network, or go on with a run that was stopped.

    Args:
        model: "att-snn" or "att-rnn".
        data: One dataset or several.
        out: Folder of the run.
        preset: One of `training.config.PRESETS`.
        progress: Called after every epoch.
        choices: Fields of `TrainConfig` that differ from the preset.

    Raises:
        ValueError: A bad choice or dataset, or another run's folder.
        FileNotFoundError: A dataset is not there.
    """
    return run(make_config(preset, model=model, data=data, **choices), Path(out), progress)


def run(config: TrainConfig, out: Path, progress: Progress | None = None) -> Result:
    """As `train`, from a whole configuration."""
    flights, validation, _ = flights_of(config)
    threads = torch.get_num_threads()
    torch.set_num_threads(config.threads)  # the result must not depend on the machine's number of cores
    try:
        state = _Run(config, flights, validation)
        claim(out, config, contents_of(config, flights, validation))
        before = state.validate() if config.init else None
        if (out / "checkpoint.pt").is_file():
            try:
                state.restore(torch.load(out / "checkpoint.pt", weights_only=True))
            except (RuntimeError, KeyError, TypeError) as error:
                raise ValueError(
                    f"{out}: its checkpoint is of another version of quadsim, choose another folder"
                ) from error
        reason = _go_on(state, out, progress)
    finally:
        torch.set_num_threads(threads)
    if not state.history:
        raise ValueError(f"{out}: stopped before the first epoch was over ({reason}), nothing to save")
    plot(out, state.history)
    best = min(state.history, key=partial(_rank, config))
    weights = out / "best.safetensors"
    return Result(weights, best, reason, None if before is None else before[0])


def exported(
    model: Model, config: TrainConfig, rate_hz: float, note: dict[str, Any]
) -> tuple[NetworkConfig, Tensors]:
    """The network as it is flown: its configuration and tensors for `save_network`."""
    spiking = config.model == "att-snn"
    network = NetworkConfig(
        model=config.model,
        rate_hz=rate_hz,
        encoding=config.encoding if isinstance(model, AttRNN) else model.w_in.shape[0],
        hidden=config.hidden if isinstance(model, AttRNN) else model.w_ff.shape[0],
        inputs=config.inputs,
        quantised=config.quantised and spiking,
        recurrent_delay=config.recurrent_delay,
        steps_per_sample=config.steps_per_sample if spiking else 1,
        output_scale=config.output_scale if spiking else 1.0,
        training=note,
    )
    if isinstance(model, AttRNN):
        return network, {name: value.numpy().copy() for name, value in model.state_dict().items()}
    with torch.no_grad():
        arrays = {name: w.numpy() for name, w in model.weights()._asdict().items()}
    if not config.quantised:
        return network, {name: w.astype(np.float32) for name, w in arrays.items()}
    return network, {
        name: np.rint(w * 256 if name in MATRICES else 4096 * (1 - w.astype(np.float64))).astype(np.int16)
        for name, w in arrays.items()
    }


def _go_on(run: _Run, out: Path, progress: Progress | None) -> str:
    """Train until something ends the run; the reason."""
    config = run.config
    try:
        while len(run.history) < config.epochs:
            losses = [e.val_mse for e in run.history]
            thin_enough = not config.thinned or _size(run.model) <= config.parameters
            if config.stop_early and thin_enough and (reason := finished(losses)):
                return reason
            epoch = run.one_epoch()
            run.history.append(epoch)
            if _rank(config, epoch) <= min(_rank(config, e) for e in run.history):
                _save_best(run, out, epoch)
            write_whole(out / "checkpoint.pt", _bytes(run.checkpoint()))
            write_log(out, run.history)
            if progress:
                progress(epoch, config)
    except KeyboardInterrupt:
        return INTERRUPTED
    except FloatingPointError as error:
        log.error("%s: training stopped, the best weights so far are kept", error)
        return str(error)
    return f"all {config.epochs} epochs done"


def _bytes(checkpoint: dict[str, Any]) -> bytes:
    """A checkpoint as PyTorch writes it; in memory, since it says of a full disk that its writer failed."""
    torch.save(checkpoint, buffer := io.BytesIO())
    return buffer.getvalue()


def _save_best(run: _Run, out: Path, epoch: Epoch) -> None:
    note = {
        "config": json.loads(run.config.model_dump_json()),
        "commit": commit(),
        "epoch": epoch.epoch + 1,
        "updates": epoch.updates,
        "training_flights": len(run.flights),
        "validation_flights": len(run.validation),
        "validation_error_deg": round(epoch.val_error_deg, 4),
    }
    with run.optimiser.evaluated():
        network, tensors = exported(run.model, run.config, run.flights.rate_hz, note)
    if run.config.thinned:
        network, tensors = connected(network, tensors)
    save_network(out / "best.safetensors", network, tensors)


def flights_of(config: TrainConfig) -> tuple[Flights, Flights, Flights]:
    """The flights to train on, to choose the best epoch by, and to test on (of `data`; none held out: empty).

    Raises:
        ValueError: Too few flights, or datasets that do not go together.
    """
    flights = load_flights(config.data)
    if config.init and not math.isclose(flights.rate_hz, rate := load_network(config.init)[0].rate_hz):
        raise ValueError(f"data at {flights.rate_hz:g} Hz, but the weights of init are for {rate:g} Hz")
    if config.folds:
        parts = fold_split(len(flights), config.folds, config.fold, config.seed)
    elif config.validation:
        return flights, _validation(config, flights), flights.select([])
    else:
        parts = split(len(flights), config.seed)
    train, validation, test = (flights.select(ids) for ids in parts)
    return train, _validation(config, flights) if config.validation else validation, test


def _validation(config: TrainConfig, flights: Flights) -> Flights:
    found = load_flights(config.validation)
    if found.rate_hz != flights.rate_hz:
        raise ValueError(f"validation at {found.rate_hz:g} Hz, but the data are at {flights.rate_hz:g} Hz")
    return found


def _new_model(config: TrainConfig) -> Model:
    torch.manual_seed(config.seed)
    if config.model == "att-rnn":
        if config.encoding != config.hidden:
            raise ValueError(
                f"att-rnn: layers of {config.encoding} and {config.hidden} units, should be equal"
            )
        return AttRNN(config.hidden)
    if config.symmetric and not config.init and min(config.encoding, config.hidden) < len(OPERATIONS):
        raise ValueError(
            f"symmetric: layers of {config.encoding} and {config.hidden} neurons, at least {len(OPERATIONS)} "
            "of each share weights; give more, or symmetric=false"
        )
    return AttSNN(
        config.encoding,
        config.hidden,
        config.quantised,
        config.recurrent_delay,
        config.output_scale,
        config.threads,
        config.symmetric,
    )


def _start(model: Model, config: TrainConfig, flights: Flights, steps: int) -> None:
    if config.init:
        start_from_weights(model, config.init)
        if isinstance(model, AttSNN) and config.thinned:
            model.keep_what_is_there()
        return
    elif isinstance(model, AttRNN):
        return
    elif config.start == "random":
        start_like_the_paper(model, config.seed)
        return
    x, roll_pitch = _sample(config, flights, steps, (config.seed, 0))
    start_from_data(model, x, roll_pitch, config.seed, config.steps_per_sample)


def _sample(
    config: TrainConfig, flights: Flights, steps: int, seed: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.floating]]:
    """Scaled inputs and targets of a few long windows, one entry for each network step."""
    several = max(1, min(3, flights.gyro.shape[1] // steps))
    batch = next(windows(flights, config.augmentation, 1, 32, several * steps, 1, seed))
    x = _inputs(config, batch)
    return x.numpy(), np.repeat(batch.roll_pitch, config.steps_per_sample, 1)


def _inputs(config: TrainConfig, batch: Batch, state: NDArray[np.void] | None = None) -> Tensor:
    """Scaled inputs of each network step, shape (n, steps, 6); `state` as in `scaled_inputs`."""
    x = scaled_inputs(config.inputs, batch.gyro, batch.accel, state)
    if config.model == "att-rnn":
        return torch.from_numpy(x.astype(np.float32))
    return torch.from_numpy(np.repeat(x, config.steps_per_sample, 1))


def _size(model: Model) -> int:
    if isinstance(model, AttSNN):
        return model.parameters_kept
    return sum(p.numel() for p in model.parameters())


def _rank(config: TrainConfig, epoch: Epoch) -> tuple[int, float]:
    """What the best epoch has the least of: parameters that it may not keep, then validation loss."""
    return (max(epoch.parameters, config.parameters) if config.thinned else 0, epoch.val_mse)


def _step(config: TrainConfig, name: str) -> float:
    """Factor of the learning rate for a parameter: one common change of many weights adds up over neurons."""
    encoding, hidden, output = config.layer_steps
    return {"w_in": encoding, "w_ff": hidden, "w_rec": hidden, "w_out": output}.get(name, 1.0)


def _learning_rate(config: TrainConfig, update: int) -> float:
    if config.decay == "none":
        return config.optimiser_lr
    share = update / (config.epochs * config.batches)
    return config.optimiser_lr * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))
