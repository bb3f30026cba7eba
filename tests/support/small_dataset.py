"""A dataset of a few short flights, and what its folder holds."""

from pathlib import Path

from quadsim.flight.recipe import Recipe
from quadsim.imu.spec import load_imu
from quadsim.vehicle import load_vehicle

FLIGHTS, DURATION, STEPS = 7, 0.5, 100
CONFIG = Recipe(vehicle=load_vehicle("hummingbird"), imu=load_imu("adis16448"), warmup_s=0.5)


def files(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}
