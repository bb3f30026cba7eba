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


def write_numbers(folder: Path, numbers: Mapping[str, Any]) -> None:
    """Keep what a stage found."""
    write_whole(folder / NUMBERS, json.dumps(numbers))


def fly(
    folder: Path, inputs: Inputs, *, domain: str, flights: int, duration_s: float, seed: int,
    rate_hz: float = 200.0, hover: bool = False,
) -> None:  # fmt: skip
    """Generate flights of a domain."""
    config: FlightConfig = flight_config(load_recipe(DOMAINS[domain]))
    if hover:
        config = config.model_copy(update={"trajectory": Hover(position=(0.0, 0.0, 20.0))})
    generate(config, flights, duration_s, folder / FLIGHTS, seed=seed, rate_hz=rate_hz, workers=1)


def tune_filter(
    folder: Path, inputs: Inputs, *, name: str, particles: int, iterations: int, seed: int
) -> None:
    """Tune a filter on the training flights of both domains with the paper's swarm."""
    data = [open_dataset(path / FLIGHTS) for path in inputs.values()]
    search = SearchSettings(particles=particles, iterations=iterations, seed=seed)
    tuned = tune(name, data, search, command="quadsim paper")
    write_tuning(folder / TUNING, name, tuned, "Tuned on the training flights of both domains.")
    write_numbers(folder, {"name": name, "values": tuned.values, "rmse_deg": tuned.rmse_deg})


def train(
    folder: Path, inputs: Inputs, *, data: Sequence[str], validation: Sequence[str], preset: str, seed: int,
    init: str = "", **choices: Any,
) -> None:  # fmt: skip
    """Train a network on stages of flights; `init` is a stage whose weights it continues from."""
    if init:
        choices["init"] = str(inputs[init] / WEIGHTS)
    config = make_config(
        preset,
        data=[inputs[name] / FLIGHTS for name in data],
        validation=[inputs[name] / FLIGHTS for name in validation],
        seed=seed,
        **choices,
    )
    result = run(config, folder)
    if result.reason == "interrupted":
        raise KeyboardInterrupt
    log = np.genfromtxt(folder / "log.csv", delimiter=",", names=True)
    write_numbers(
        folder,
        {
            "updates": np.atleast_1d(log["updates"]).tolist(),
            "train_mse": (np.radians(np.atleast_1d(log["train_rmse_deg"])) ** 2).tolist(),
            "val_mse": np.atleast_1d(log["val_mse"]).tolist(),
            "seconds": float(np.atleast_1d(log["seconds"])[-1]),
            "best": asdict(result.best),
        },
    )


def fold(
    folder: Path, inputs: Inputs, *, domain: str, others: Sequence[str], fold: int, folds: int, preset: str,
    seed: int, **choices: Any,
) -> None:  # fmt: skip
    """Train and score a fold of a domain, as `quadsim kfold` does."""
    names = {f"fly-{name}": name for name in (domain, *others)}
    paths = {name: str(inputs[stage] / FLIGHTS) for stage, name in names.items()}
    config = make_config(preset, data=paths[domain], folds=folds, fold=fold, seed=seed, **choices)
    scores = run_fold(Job(config, domain, {name: paths[name] for name in others}, folder))
    write_numbers(folder, {"scores": [asdict(score) for score in scores]})


def rescale(folder: Path, inputs: Inputs, *, rate_hz: float) -> None:
    """Carry a network to another sample rate."""
    (source,) = inputs.values()
    save_network(folder / WEIGHTS, *rescaled(*load_network(source / WEIGHTS), rate_hz))


def distributions(folder: Path, inputs: Inputs) -> None:
    """Histograms of the inputs and outputs of every domain (Fig. 3)."""
    found = {}
    for stage, path in inputs.items():
        data = open_dataset(path / FLIGHTS)
        columns = {
            **{f"gyro {axis} [rad/s]": data["gyro"].to_numpy()[..., k] for k, axis in enumerate("xyz")},
            **{f"accel {axis} [m/s²]": data["accel"].to_numpy()[..., k] for k, axis in enumerate("xyz")},
        }
        angles = np.degrees(roll_pitch_from_quat(data["quat"].to_numpy().astype(np.float64)))
        columns |= {f"{name} [°]": angles[..., k] for k, name in enumerate(("roll", "pitch"))}
        found[stage.removeprefix("fly-")] = {name: _histogram(values) for name, values in columns.items()}
    write_numbers(folder, found)


def _histogram(values: np.ndarray) -> dict[str, Any]:
    limits = np.percentile(values, (0.1, 99.9))
    density, edges = np.histogram(values, BINS, (limits[0], limits[1]), density=True)
    return {"edges": edges.tolist(), "density": density.tolist(), "sd": float(values.std(dtype=np.float64))}
