"""The files of a run: configuration, digests of what it reads, log and loss curve."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from pydantic import ValidationError

from quadsim.runs.files import save_figure, write_whole
from quadsim.runs.fingerprint import code_digest

from .config import CircuitRun, TrainConfig


@dataclass(frozen=True)
class Epoch:
    """A row of the log."""

    epoch: int
    updates: int
    train_loss: float
    """Mean square error over the windows of the epoch [rad²; of a controller in units of its error scale]; of
    a circuit its own loss."""
    learning_rate: float
    figures: dict[str, float]
    """Of the updates: spikes per neuron and step, or the longest component of a vector."""
    validation: dict[str, float]
    """Figures of merit on the validation flights; of a circuit after the last update only."""
    seconds: float = 0.0
    """Time of training so far."""

    @property
    def score(self) -> float:
        """The first of the figures, which chooses the best epoch."""
        return next(iter(self.validation.values()))

    def rank(self) -> float:
        """The best epoch has the least."""
        return self.score if math.isfinite(self.score) else math.inf

    def __str__(self) -> str:
        """The numbers, for people."""
        validation = {f"validation {name}": value for name, value in self.validation.items()}
        shown = (
            f"{name.removesuffix('_deg')} {value:.2f}°" if name.endswith("_deg") else f"{name} {value:.4g}"
            for name, value in {"training loss": self.train_loss, **validation, **self.figures}.items()
        )
        return ", ".join(shown).replace("_", " ")

    def row(self) -> dict[str, float]:
        """The numbers by column of `log.csv`."""
        own = asdict(self)
        judged = {f"validation_{name}": value for name, value in own.pop("validation").items()}
        return own | own.pop("figures") | judged


def claim(out: Path, config: TrainConfig | CircuitRun, flights: dict[str, str]) -> None:
    """Make the folder this run's; `flights` are the digests of what it trains on.

    Raises:
        ValueError: It holds a run with another configuration, of another version, or on files that have
            changed.
    """
    out.mkdir(parents=True, exist_ok=True)
    file = out / "config.json"
    if file.is_file():
        try:
            before = type(config).model_validate_json(file.read_text(encoding="utf-8"))
        except ValidationError:
            raise ValueError(
                f"{out}: holds a run of another version of quadsim, choose another folder"
            ) from None
        if before != config:
            raise ValueError(f"{out}: holds a run with another configuration, choose another folder")
    write_whole(file, config.model_dump_json(indent=2))
    contents = flights | {"code": code_digest("training.epochs")}
    file = out / "contents.json"
    if file.is_file():
        try:
            old = dict(json.loads(file.read_text(encoding="utf-8")))
        except (ValueError, TypeError):
            raise ValueError(f"{file}: damaged, choose another folder") from None
        if old != contents:
            changed = ", ".join(name for name in contents if old.get(name) != contents[name])
            raise ValueError(f"{out}: holds a run on other files ({changed} changed), choose another folder")
    write_whole(file, json.dumps(contents, indent=2))


@contextmanager
def tensorboard_events(out: Path) -> Iterator[Callable[[Epoch], None]]:
    """What writes an epoch's row of the log into a run's folder as events of TensorBoard.

    A run that continues adds a file of events. Nothing is written before the first epoch.

    Raises:
        ModuleNotFoundError: TensorBoard is not installed.
    """
    from torch.utils.tensorboard import SummaryWriter

    with ExitStack() as stack:
        writer = cache(lambda: stack.enter_context(SummaryWriter(str(out))))

        def write(epoch: Epoch) -> None:
            for name, value in epoch.row().items():
                if name != "epoch":
                    writer().add_scalar(name, value, epoch.epoch + 1)
            writer().flush()

        yield write


def plot(out: Path, history: list[Epoch]) -> None:
    """Training loss and the score over the epochs (the paper's Fig. 4)."""
    from matplotlib.figure import Figure

    panels = {"loss on training windows": [e.train_loss for e in history]}
    if judged := history[0].validation:
        panels[f"{next(iter(judged))} on validation flights"] = [e.score for e in history]
    figure = Figure(figsize=(7, 2.5 * len(panels)), layout="constrained")
    every = figure.subplots(len(panels), squeeze=False)[:, 0]
    for axes, (label, values) in zip(every, panels.items(), strict=True):
        axes.semilogy([e.epoch + 1 for e in history], values)
        axes.set(ylabel=label, xlabel="epoch")
        axes.grid(alpha=0.3)
    save_figure(out / "curve.png", figure, dpi=150, bbox_inches="tight")
