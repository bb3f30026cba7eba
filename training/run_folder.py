"""The files of a run: configuration, checkpoint, weights and loss curve."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import ValidationError

from quadsim.runs.files import save_figure, write_whole
from quadsim.runs.fingerprint import code_digest

from .config import TrainConfig


@dataclass(frozen=True)
class Epoch:
    """A row of the log."""

    epoch: int
    updates: int
    train_loss: float
    """Mean square error over the windows of the epoch [rad²; of a controller in units of its error scale]."""
    rate_encoding: float
    """Spikes per neuron and step while training."""
    rate_hidden: float
    learning_rate: float
    validation: dict[str, float]
    """Figures of merit on the validation flights, see `validate` of the task."""
    seconds: float
    """Time of training so far."""

    @property
    def score(self) -> float:
        """The first of the figures, which chooses the best epoch."""
        return next(iter(self.validation.values()))

    def rank(self) -> float:
        """The best epoch has the least."""
        return self.score if math.isfinite(self.score) else math.inf

    def __str__(self) -> str:
        """The figures of merit, for people."""
        shown = (
            f"{name.removesuffix('_deg')} {value:.2f}°" if name.endswith("_deg") else f"{name} {value:.4g}"
            for name, value in self.validation.items()
        )
        return ", ".join(shown)

    def row(self) -> dict[str, float]:
        """The numbers by column of `log.csv`."""
        own = asdict(self)
        return own | {f"validation_{name}": value for name, value in own.pop("validation").items()}


def claim(out: Path, config: TrainConfig, contents: dict[str, str] | None = None) -> None:
    """Make the folder this run's; `contents` are digests by `contents_of`, None: they are not compared.

    Raises:
        ValueError: It holds a run with another configuration, of another version, or on files that have
            changed.
    """
    out.mkdir(parents=True, exist_ok=True)
    file, text = out / "config.json", config.model_dump_json(indent=2)
    if file.is_file():
        try:
            before = TrainConfig.model_validate_json(file.read_text(encoding="utf-8"))
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


def contents_of(config: TrainConfig, flights: dict[str, str]) -> dict[str, str]:
    """Digests of what a run reads, its flights' among them, so that a run on other files is refused."""
    return flights | {"code": code_digest("training.loop")}


def plot(out: Path, history: list[Epoch]) -> None:
    """Training loss and the score over the epochs (the paper's Fig. 4)."""
    from matplotlib.figure import Figure

    above, below = (figure := Figure(figsize=(7, 5), layout="constrained")).subplots(2, sharex=True)
    epochs = [e.epoch + 1 for e in history]
    above.semilogy(epochs, [e.train_loss for e in history])
    above.set(ylabel="loss on training windows")
    below.semilogy(epochs, [e.score for e in history])
    below.set(ylabel=f"{next(iter(history[0].validation))} on validation flights", xlabel="epoch")
    for axes in (above, below):
        axes.grid(alpha=0.3)
    save_figure(out / "curve.png", figure, dpi=150, bbox_inches="tight")
