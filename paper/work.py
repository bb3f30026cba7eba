"""Stages that make things: flights, tuned filters, networks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from estimators.networks.weights_file import load_network, save_network
from estimators.tuning.search import SearchSettings, tune, write_tuning
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import flight_config, load_recipe
from quadsim.flight.simulate import FlightConfig
from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.files import write_whole
from quadsim.trajectory.specs import Hover
from training.config import make_config
from training.kfold import Job, run_fold
from training.loop import run
from training.rescale import rescaled

FLIGHTS, WEIGHTS, TUNING, NUMBERS = "flights.zarr", "best.safetensors", "tuned.toml", "numbers.json"
DOMAINS = {"sim": "hummingbird", "real": "px4"}
"""Name of each domain and its recipe."""
BINS = 100
Inputs = Mapping[str, Path]
"""Stage to its folder."""
Names = Sequence[str]


def write_numbers(folder: Path, numbers: Mapping[str, Any]) -> None:
    """Write the numbers of a stage."""
    write_whole(folder / NUMBERS, json.dumps(numbers))


def fly(folder: Path, inputs: Inputs, *, domain: str, hover: bool = False, **settings: Any) -> None:
    """Generate flights of a domain; settings: of `generate`."""
    config: FlightConfig = flight_config(load_recipe(DOMAINS[domain]))
    if hover:
        config = config.model_copy(update={"trajectory": Hover(position=(0.0, 0.0, 20.0))})
    generate(config, out=folder / FLIGHTS, workers=1, **settings)


def tune_filter(folder: Path, inputs: Inputs, *, name: str, **search: Any) -> None:
    """Tune a filter on the training flights of both domains with the paper's swarm."""
    data = [open_dataset(path / FLIGHTS) for path in inputs.values()]
    tuned = tune(name, data, SearchSettings(**search), command="quadsim paper")
    write_tuning(folder / TUNING, name, tuned, "Tuned on the training flights of both domains.")
    write_numbers(folder, {"values": tuned.values, "rmse_deg": tuned.rmse_deg})


def train(
    folder: Path, inputs: Inputs, *, data: Names, validation: Names, init: str = "", **choices: Any
) -> None:
    """Train a network on stages of flights; `init` is a stage whose weights it continues from."""
    if init:
        choices["init"] = str(inputs[init] / WEIGHTS)
    train, choose = ([inputs[name] / FLIGHTS for name in names] for names in (data, validation))
    result = run(make_config(data=train, validation=choose, **choices), folder)
    if result.reason == "interrupted":
        raise KeyboardInterrupt
    log = np.atleast_1d(np.genfromtxt(folder / "log.csv", delimiter=",", names=True))
    numbers = {
        "updates": log["updates"].tolist(),
        "train_mse": (np.radians(log["train_rmse_deg"]) ** 2).tolist(),
        "val_mse": log["val_mse"].tolist(),
        "seconds": float(log["seconds"][-1]),
        "best": asdict(result.best),
    }
    write_numbers(folder, numbers)


def fold(folder: Path, inputs: Inputs, *, domain: str, other: str, **choices: Any) -> None:
    """Train and score a fold of a domain, as `quadsim kfold` does."""
    own, others = (str(inputs[f"fly-{name}"] / FLIGHTS) for name in (domain, other))
    scores = run_fold(Job(make_config(data=own, **choices), domain, {other: others}, folder))
    write_numbers(folder, {"scores": [asdict(score) for score in scores]})


def rescale(folder: Path, inputs: Inputs, *, rate_hz: float) -> None:
    """Carry a network to another sample rate."""
    (source,) = inputs.values()
    save_network(folder / WEIGHTS, *rescaled(*load_network(source / WEIGHTS), rate_hz))


def distributions(folder: Path, inputs: Inputs) -> None:
    """Histograms of the inputs and outputs of every domain (Fig. 3)."""
    domains = {}
    for stage, path in inputs.items():
        data = open_dataset(path / FLIGHTS)
        angles = np.degrees(roll_pitch_from_quat(data["quat"].to_numpy().astype(np.float64)))
        columns = {
            f"{name} {axis} [{unit}]": data[name].to_numpy()[..., k]
            for name, unit in (("gyro", "rad/s"), ("accel", "m/s²"))
            for k, axis in enumerate("xyz")
        } | {"roll [°]": angles[..., 0], "pitch [°]": angles[..., 1]}
        domains[stage.removeprefix("fly-")] = {name: _histogram(values) for name, values in columns.items()}
    write_numbers(folder, domains)


def _histogram(values: np.ndarray) -> dict[str, Any]:
    low, high = np.percentile(values, (0.1, 99.9))
    density, edges = np.histogram(values, BINS, (low, high), density=True)
    return {"edges": edges.tolist(), "density": density.tolist(), "sd": float(values.std(dtype=np.float64))}
