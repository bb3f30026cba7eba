"""The files of a run: configuration, digests of its inputs, log and loss curve."""

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
    """An epoch, a row of the log."""

    epoch: int
    updates: int
    train_loss: float
    """Mean square error over the windows of the epoch [rad², or for a controller in units of its error
    scale]; for a circuit, its loss."""
    learning_rate: float
    figures: dict[str, float]
    """Measures of the training: spikes per neuron and step, or the largest component of a vector."""
    validation: dict[str, float]
    """Measures on the validation flights; for a circuit, only after the last update."""
    seconds: float = 0.0
    """Training time since the start of the run [s]."""

    @property
    def score(self) -> float:
        """The first validation measure, which selects the best epoch."""
        return next(iter(self.validation.values()))

    def rank(self) -> float:
        """Sort key; the best epoch has the smallest one."""
        return self.score if math.isfinite(self.score) else math.inf

    def __str__(self) -> str:
        """Return the measures as text."""
        validation = {f"validation {name}": value for name, value in self.validation.items()}
        shown = (
            f"{name.removesuffix('_deg')} {value:.2f}°" if name.endswith("_deg") else f"{name} {value:.4g}"
            for name, value in {"training loss": self.train_loss, **validation, **self.figures}.items()
        )
        return ", ".join(shown).replace("_", " ")

    def row(self) -> dict[str, float]:
        """Return the measures by column of `log.csv`."""
        own = asdict(self)
        judged = {f"validation_{name}": value for name, value in own.pop("validation").items()}
        return own | own.pop("figures") | judged


def claim(out: Path, config: TrainConfig | CircuitRun, flights: dict[str, str]) -> None:
    """Claim a folder for this run; `flights` are the digests of its inputs.

    Raises:
        ValueError: The folder contains a run with another configuration, of another version, or with other
            inputs.
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
    """Make a function that writes epochs as TensorBoard events to the folder of a run.

    A continued run adds a file of events. Nothing is written before the first epoch.

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


def plot_history(out: Path, history: list[Epoch]) -> None:
    """Draw training loss and score over the epochs, as in the paper's Fig. 4."""
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
