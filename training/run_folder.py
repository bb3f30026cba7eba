"""The folder of a run: whose it is, its log and its curve; files that are either the old ones or whole."""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import ValidationError

from estimators.networks.weights_file import load_network
from quadsim.runs.files import drop_parts, save_figure, write_csv, write_whole
from quadsim.runs.fingerprint import code_digest

from .config import TrainConfig
from .data import Flights


@dataclass(frozen=True)
class Epoch:
    """A row of the log."""

    epoch: int
    updates: int
    train_rmse_deg: float
    """Root mean square error over the windows of the epoch."""
    val_mse: float
    """Mean square error on the validation flights [rad²], which chooses the best epoch."""
    val_error_deg: float
    """Mean absolute error of roll and pitch over whole validation flights, unknown initial attitude."""
    val_settled_deg: float
    """The same without the first 5 s."""
    rate_encoding: float
    """Spikes per neuron and step while training."""
    rate_hidden: float
    learning_rate: float
    parameters: int
    """Connections that are left, and time constants (att-rnn: weights and biases)."""
    seconds: float
    """Time that training has taken so far."""


def claim(out: Path, config: TrainConfig, contents: dict[str, str] | None = None) -> None:
    """Make the folder this run's.

    Args:
        out: The folder.
        config: Of the run.
        contents: What `contents_of` says of its files; None: they are not compared.

    Raises:
        ValueError: It holds a run with another configuration, of another version, or on files that have
            changed.
    """
    out.mkdir(parents=True, exist_ok=True)
    drop_parts(out)
    file, text = out / "config.json", config.model_dump_json(indent=2)
    if file.is_file():
        try:
            there = TrainConfig.model_validate_json(file.read_text(encoding="utf-8"))
        except ValidationError as error:
            raise ValueError(
                f"{out}: holds a run of another version of quadsim, choose another folder"
            ) from error
        if there != config:
            raise ValueError(f"{out}: holds a run with another configuration, choose another folder")
    write_whole(file, text)
    if contents is None:
        return
    kept = out / "contents.json"
    if kept.is_file() and (old := json.loads(kept.read_text(encoding="utf-8"))) != contents:
        changed = ", ".join(name for name in contents if old.get(name) != contents[name])
        raise ValueError(f"{out}: holds a run on other files ({changed} changed), choose another folder")
    write_whole(kept, json.dumps(contents, indent=2))


def contents_of(config: TrainConfig, flights: Flights, validation: Flights) -> dict[str, str]:
    """Digests of what a run reads, so that going on with it on other files is noticed."""
    found = {
        "data": flights.digest(),
        "validation": validation.digest(),
        "code": code_digest("training.loop"),
    }
    if config.init:
        digest = hashlib.blake2b(digest_size=16)
        for name, tensor in sorted(load_network(config.init)[1].items()):
            digest.update(name.encode() + tensor.tobytes())
        found["init"] = digest.hexdigest()
    return found


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


def commit() -> str:
    """The commit of the code, where it runs from its own repository; "-dirty" where that has changes."""
    root = Path(__file__).parents[1]

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=False
        ).stdout.strip()

    try:
        ours = Path(git("rev-parse", "--show-toplevel") or "/").samefile(root)
        return git("describe", "--always", "--dirty", "--exclude=*") if ours else ""
    except OSError:  # no git
        return ""
