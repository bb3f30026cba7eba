"""The simulated flights that pages score estimators on, generated where they are missing."""

from pathlib import Path
from typing import NamedTuple

import xarray as xr

from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed

DURATION_S = 100.0


class Made(NamedTuple):
    """How a dataset is generated."""

    recipe: str
    flights: int
    seed: int
    imu: str | None = None
    """In place of the recipe's."""


SETS = {
    "train": Made("hummingbird", 35, 0),
    "test": Made("hummingbird", 16, 3),
    "test-px4": Made("px4", 16, 6),
    "val": Made("hummingbird", 8, 2),
    "val-windy": Made("windy", 4, 5),
    "val-gusty": Made("gusty", 4, 42),
    "val-turbulent": Made("turbulent", 4, 62),
    "val-rough": Made("hummingbird", 8, 7, imu="rough"),
    "val-px4": Made("px4", 8, 26),
}
"""Nothing was trained or tuned on these, but on `train`. The networks' epochs were chosen on the
Hummingbird's of `val`."""


def simulated(name: str, data: Path) -> xr.Dataset:
    """One of `SETS` from the folder of the datasets."""
    made = SETS[name]
    recipe = load_recipe(made.recipe)
    if made.imu is not None:
        recipe = changed(recipe, {"imu": made.imu})
    path = generate(recipe, made.flights, DURATION_S, data / f"{name}.zarr", seed=made.seed)
    return open_dataset(path)
