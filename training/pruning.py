"""Pruning of neurons with fine-tuning: remove neurons, train the others, and again, down to a size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from estimators.analysis.ablation import Pruned, error_deg, importance, pruned
from estimators.analysis.activity import record
from estimators.evaluation.flights import load_flights
from estimators.networks.network import OnLoihi
from estimators.networks.weights_file import (
    attitude_network,
    load_network,
    parameters,
    save_network,
    shipped_network,
)
from quadsim.dataset.reading import open_dataset

from .loop import Progress, train

RANKED_ON = 4
"""Flights of each dataset on which neurons are ranked."""


def prune(
    data: tuple[str, ...],
    validation: tuple[str, ...],
    out: str | Path,
    fraction: float = 0.4,
    stages: int = 2,
    by: str = "contribution",
    weights: str | Path | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> list[Pruned]:
    """Remove the least important neurons in equal steps, and train the others after each.

    Neurons are ranked on training flights; the epochs are chosen by the validation flights.

    Args:
        data: Datasets to rank and to train on.
        validation: Datasets to choose epochs and to score by.
        out: Folder; it holds a run for each stage, which continues where it was stopped.
        fraction: Share of the neurons to remove in the end.
        stages: Steps to get there.
        by: How neurons are ranked, see `estimators.analysis.ablation.importance`.
        weights: Of an Att-SNN for the chip; None: the ones that ship.
        progress: Called after every epoch.
        choices: Fields of the training configuration that differ from the preset "best".

    Returns:
        The network before pruning, then one entry a stage.

    Raises:
        ValueError: A bad fraction, number of stages or choice.
    """
    if stages < 1:
        raise ValueError(f"stages: {stages}, should be at least 1")
    config, tensors = shipped_network("att-snn") if weights is None else attitude_network(weights)
    flights = load_flights(list(map(open_dataset, data)), RANKED_ON)
    scored = load_flights(list(map(open_dataset, validation)))
    full = config.encoding, config.hidden
    start = Path(out) / "unpruned.safetensors"
    save_network(start, config, tensors)
    error = error_deg(config, tensors, scored)
    done = [Pruned(0.0, *full, parameters(tensors), error, error, start)]
    for stage in range(1, stages + 1):
        goal = 1 - fraction * stage / stages
        share = 1 - goal * sum(full) / (config.encoding + config.hidden)
        activity = record(OnLoihi(config, tensors), flights.gyro, flights.accel)
        cut, fewer = pruned(config, tensors, importance(tensors, activity, by), max(share, 0.0))
        before = Path(out) / f"cut-{stage}.safetensors"
        save_network(before, cut, fewer)
        files = {"data": data, "validation": validation, "init": str(before)}
        result = train(out=Path(out) / f"stage-{stage}", preset="best", progress=progress, **files, **choices)
        weights, cut_error = result.weights, error_deg(cut, fewer, scored)
        config, tensors = load_network(weights)
        tuned = error_deg(config, tensors, scored)
        if tuned > cut_error:  # training did not help
            weights, config, tensors, tuned = before, cut, fewer, cut_error
        sizes = config.encoding, config.hidden
        removed = 1 - sum(sizes) / sum(full)
        done.append(Pruned(removed, *sizes, parameters(tensors), cut_error, tuned, weights))
    return done
