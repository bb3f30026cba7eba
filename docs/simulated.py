"""The simulated flights that pages score estimators on, generated where they are missing."""

from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import Recipe, load_recipe
from quadsim.flight.scenario import changed

DURATION_S = 100.0
PX4 = {"vehicle": "px4-quad", "imu": "px4-mini", "trajectory": {"kind": "mix", "dash_s": (1.3, 3.0)}}
"""What differs from the recipe of the Hummingbird: this airframe has less torque per inertia."""


class Generated(NamedTuple):
    """How a dataset is generated."""

    recipe: str
    flights: int
    seed: int
    changes: dict[str, Any] | None = None
    """What differs from the recipe."""
    duration_s: float = DURATION_S

    def config(self) -> Recipe:
        """The recipe with its changes."""
        return changed(load_recipe(self.recipe), self.changes or {})

    def at(self, path: Path) -> xr.Dataset:
        """The dataset in this file."""
        return open_dataset(generate(self.config(), self.flights, self.duration_s, path, seed=self.seed))


SETS = {
    "train": Generated("hummingbird", 35, 0),
    "test": Generated("hummingbird", 16, 3),
    "test-px4": Generated("hummingbird", 16, 6, PX4),
    "val": Generated("hummingbird", 8, 2),
    "val-turbulent": Generated("turbulent", 4, 62),
    "val-rough": Generated("hummingbird", 8, 7, {"imu": "rough"}),
    "val-px4": Generated("hummingbird", 8, 26, PX4),
}
"""Nothing was trained or tuned on these, but on `train`. The networks' epochs were chosen on the
Hummingbird's of `val`."""


def simulated(name: str, data: Path) -> xr.Dataset:
    """One of `SETS` from the folder of the datasets."""
    return SETS[name].at(data / f"{name}.zarr")
