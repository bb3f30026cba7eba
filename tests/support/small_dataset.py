"""Generated datasets: one of a few short flights and what its folder holds, and others of any recipe."""

from pathlib import Path

import xarray as xr

from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import Recipe, load_recipe
from quadsim.imu.spec import load_imu
from quadsim.vehicle import load_vehicle

FLIGHTS, DURATION, STEPS = 7, 0.5, 100
CONFIG = Recipe(vehicle=load_vehicle("hummingbird"), imu=load_imu("adis16448"), warmup_s=0.5)


def files(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def generated(folder: Path, recipe: Recipe | str, flights: int, seconds: float, seed: int) -> xr.Dataset:
    config = load_recipe(recipe) if isinstance(recipe, str) else recipe
    return open_dataset(generate(config, flights, seconds, folder / "flights.zarr", seed=seed, workers=1))
