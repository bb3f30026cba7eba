"""The files of a run: configuration, log, checkpoint, best weights and loss curve."""

from __future__ import annotations

import hashlib
import io
import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import ValidationError

from estimators.analysis.ablation import connected
from estimators.networks.weights_file import EXPONENTS, NetworkConfig, Tensors, load_network, save_network
from estimators.spiking import weight_exponents
from quadsim.config.toml import Strict
from quadsim.runs.files import drop_parts, save_figure, write_csv, write_whole
from quadsim.runs.fingerprint import code_digest
from quadsim.runs.record import commit

from .config import TrainConfig, TrainingRecipe
from .data import TrainingFlights
from .models import AttRNN, AttSNN


@dataclass(frozen=True)
class Epoch:
    """A row of the log."""

    epoch: int
    updates: int
    train_rmse_deg: float
    """Root mean square error over the windows of the epoch."""
    val_mse: float
    """Mean square error on the validation flights [rad²], which chooses the best epoch; of up half the mean
    square of the inclination error, which is the same for small tilts."""
    val_error_deg: float
    """Mean absolute error of roll and pitch over complete validation flights, unknown initial attitude."""
    val_settled_deg: float
    """The same without the first 5 s."""
    val_inclination_deg: float
    """Root mean square of the inclination error over them."""
    rate_encoding: float
    """Spikes per neuron and step while training."""
    rate_hidden: float
    learning_rate: float
    parameters: int
    """Connections and time constants (att-rnn: weights and biases)."""
    seconds: float
    """Time of training so far."""


def claim(out: Path, config: Strict, contents: dict[str, str] | None = None) -> None:
    """Make the folder this run's; `contents` are digests by `contents_of`, None: they are not compared.

    Raises:
        ValueError: It holds a run with another configuration, of another version, or on files that have
            changed.
    """
    out.mkdir(parents=True, exist_ok=True)
    drop_parts(out)
    file, text = out / "config.json", config.model_dump_json(indent=2)
    if file.is_file():
        try:
            before = type(config).model_validate_json(file.read_text(encoding="utf-8"))
        except ValidationError:
            raise ValueError(
                f"{out}: holds a run of another version of quadsim, choose another folder"
            ) from None
        if before.model_copy(update={"threads": config.threads}) != config:  # changes the last digits alone
            raise ValueError(f"{out}: holds a run with another configuration, choose another folder")
    write_whole(file, text)
    if contents is None:
        return
    file = out / "contents.json"
    if file.is_file() and (old := json.loads(file.read_text(encoding="utf-8"))) != contents:
        changed = ", ".join(name for name in contents if old.get(name) != contents[name])
        raise ValueError(f"{out}: holds a run on other files ({changed} changed), choose another folder")
    write_whole(file, json.dumps(contents, indent=2))


def contents_of(config: TrainConfig, flights: TrainingFlights, validation: TrainingFlights) -> dict[str, str]:
    """Digests of what a run reads, so that a run on other files is refused."""
    digests = {"data": flights.digest(), "validation": validation.digest()}
    digests["code"] = code_digest("training.loop")
    if config.init:
        digest = hashlib.blake2b(digest_size=16)
        for name, tensor in sorted(load_network(config.init)[1].items()):
            digest.update(name.encode() + tensor.tobytes())
        digests["init"] = digest.hexdigest()
    return digests


def exported(
    model: AttSNN | AttRNN, config: TrainConfig, rate_hz: float, note: dict[str, Any]
) -> tuple[NetworkConfig, Tensors]:
    """The network as an estimator runs it: its configuration and tensors for `save_network`."""
    spiking = isinstance(model, AttSNN)
    network = NetworkConfig(
        model=config.model,
        rate_hz=rate_hz,
        encoding=model.w_in.shape[0] if spiking else config.encoding,
        hidden=model.w_ff.shape[0] if spiking else config.hidden,
        inputs=config.inputs,
        quantised=config.quantised and spiking,
        recurrent_delay=config.recurrent_delay,
        after_spike=config.after_spike and spiking,
        steps_per_sample=config.steps_per_sample if spiking else 1,
        outputs=config.outputs,
        output_scale=config.output_scale if spiking else 1.0,
        training=note,
    )
    if not spiking:
        return network, {name: value.numpy().copy() for name, value in model.state_dict().items()}
    return network, spiking_tensors(model, config)


def spiking_tensors(model: AttSNN, config: TrainingRecipe) -> Tensors:
    """The tensors of a spiking network for `save_network`."""
    with torch.no_grad():
        arrays = {name: w.numpy() for name, w in model.weights()._asdict().items() if w.numel()}
    if not config.quantised:
        return {name: w.astype(np.float32) for name, w in arrays.items()}
    taus = {name: 4096 * (1 - arrays[name].astype(np.float64)) for name in model.taus}
    mantissas = {name: arrays[name] * 256 for name in model.matrices}
    exps = {}
    for name in mantissas.keys() & EXPONENTS.keys() if config.finest_exponent else ():
        exp = EXPONENTS[name]
        exps[exp] = weight_exponents(torch.from_numpy(arrays[name]), config.finest_exponent).numpy()[:, 0]
        mantissas[name] = mantissas[name] * np.exp2(-exps[exp])[:, None]
    return {name: np.rint(value).astype(np.int16) for name, value in (mantissas | taus | exps).items()}


def save_best(
    out: Path, model: AttSNN | AttRNN, config: TrainConfig, flights: TrainingFlights, note: dict[str, Any]
) -> None:
    """Write `best.safetensors`; of a pruned network only the neurons that are still connected.

    `note` is what the file says of the training, besides its configuration, code and number of flights.
    """
    code = {"config": json.loads(config.model_dump_json()), "commit": commit()}
    note = code | {"training_flights": len(flights), "vehicles": list(flights.vehicles)} | note
    network, tensors = exported(model, config, flights.rate_hz, note)
    if config.prunes:
        network, tensors = connected(network, tensors)
    save_network(out / "best.safetensors", network, tensors)


def save_checkpoint(out: Path, state: dict[str, Any]) -> None:
    """Write `checkpoint.pt`; by way of memory, since PyTorch reports a full disk as a failed writer."""
    torch.save(state, buffer := io.BytesIO())
    write_whole(out / "checkpoint.pt", buffer.getvalue())


def write_log(out: Path, history: list[Epoch]) -> None:
    """A row of `log.csv` for each epoch."""
    write_csv(out / "log.csv", [asdict(epoch) for epoch in history])


def plot(out: Path, history: list[Epoch]) -> None:
    """Training and validation loss over the epochs (the paper's Fig. 4)."""
    from matplotlib.figure import Figure

    axes = (figure := Figure(figsize=(7, 4))).subplots()
    epochs = [e.epoch + 1 for e in history]
    axes.semilogy(epochs, [math.radians(e.train_rmse_deg) ** 2 for e in history], label="training windows")
    axes.semilogy(epochs, [e.val_mse for e in history], label="validation flights")
    axes.set(xlabel="epoch", ylabel="mean square error [rad²]")
    axes.legend()
    axes.grid(alpha=0.3)
    save_figure(out / "curve.png", figure, dpi=150, bbox_inches="tight")
