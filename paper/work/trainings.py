"""Stages that train networks by the paper's recipe, until one of its rules ends the training."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from training.config import make_config
from training.epochs import train_epochs

from ..stages import FLIGHTS, Numbers


def train_network(
    folder: Path, *, data: Sequence[Path], validation: Sequence[Path], **choices: Any
) -> Numbers:
    """Train a network; without validation flights, 70 % of the flights train and 20 % validate.

    `choices` are fields of `TrainConfig`.
    """
    train_network, choose = ([path / FLIGHTS for path in paths] for paths in (data, validation))
    result = train_epochs(make_config(data=train_network, validation=choose, **choices), folder)
    if result.reason == "interrupted":
        raise KeyboardInterrupt
    log = np.atleast_1d(np.genfromtxt(folder / "log.csv", delimiter=",", names=True))
    best = result.best
    return {
        "updates": log["updates"].tolist(),
        "train_mse": log["train_loss"].tolist(),
        "val_mse": log["validation_loss"].tolist(),
        "seconds": float(log["seconds"][-1]),
        "best": {
            "epoch": best.epoch,
            "val_mse": best.score,
            "val_error_deg": best.validation["error_deg"],
            "rate_encoding": best.figures["rate_encoding"],
            "rate_hidden": best.figures["rate_hidden"],
        },
        "reason": result.reason,
    }
