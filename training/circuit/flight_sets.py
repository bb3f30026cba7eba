"""Training flights of a circuit, which the preset defines, for runs without data."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quadsim.dataset.generation import generate
from quadsim.dataset.store import Progress
from quadsim.flight.recipe import changed_recipe
from quadsim.held_out import reserved_by

from ..config import CircuitRun

FLIGHT_S = 60.0


def own_flights(config: CircuitRun, out: Path, progress: Progress = lambda done, total: None) -> CircuitRun:
    """Return the run with the datasets of its preset as data; generate missing ones in `out`.

    Raises:
        ValueError: A recipe, a vehicle or a key is unknown, windows are longer than the flights, or `out`
            contains flights of another training.
    """
    if config.window_s > FLIGHT_S:
        raise ValueError(f"window_s: {config.window_s:g}, but the flights have {FLIGHT_S:g} s")
    recipes = [
        (changed_recipe(each.recipe, each.changes | {"vehicle": vehicle}, each.recipe), flights)
        for each in config.flight_sets
        for vehicle, flights in each.flights.items()
    ]
    total, done, paths = sum(flights for _, flights in recipes), 0, []
    for index, (recipe, flights) in enumerate(recipes):
        drawn = np.random.SeedSequence([config.seed, index]).generate_state(8).tolist()
        seed = next(each for each in drawn if not reserved_by(each))

        def report(part: int, _: int, before: int = done) -> None:
            progress(before + part, total)

        path = out / f"{index:02d}.zarr"
        try:
            paths.append(str(generate(recipe, flights, FLIGHT_S, path, seed=seed, progress=report)))
        except ValueError as error:
            if "another dataset" not in str(error):
                raise
            raise ValueError(f"{out}: holds the flights of another training, choose another --out") from error
        done += flights
    return config.model_copy(update={"data": tuple(paths)})
