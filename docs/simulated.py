"""The simulated flights that pages score estimators on, generated where they are missing."""

from pathlib import Path

import xarray as xr
from numpy.typing import NDArray

from estimators import run
from estimators.flights import Flights
from quadsim.dataset import generate, open_dataset
from quadsim.estimator import AttitudeEstimator
from quadsim.recipe import flight_config, load_recipe

DURATION_S = 100.0
SETS = {
    "test": ("hummingbird", 16, 3),
    "test-px4": ("px4", 16, 6),
    "val": ("hummingbird", 8, 2),
}
"""Dataset to recipe, flights and seed. Nothing was trained or tuned on the first two."""


def simulated(name: str, data: Path) -> xr.Dataset:
    """One of `SETS` from the folder of the datasets."""
    path = data / f"{name}.zarr"
    if not path.exists():
        recipe, flights, seed = SETS[name]
        generate(flight_config(load_recipe(recipe)), flights, DURATION_S, path, seed=seed)
    return open_dataset(path)


def estimate_of(est: AttitudeEstimator, flights: Flights) -> NDArray:
    """Roll and pitch (n, T, 2) [rad], from the start that the flights have."""
    return run(est, flights.gyro, flights.accel, roll_pitch=flights.start, quat=flights.quat)
