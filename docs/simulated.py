"""The flights that pages score estimators on, simulated where they are missing.

Those of RotorPy, a simulator by other authors, take about three minutes of CPU time. Nothing was trained or
tuned on them.
"""

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import Recipe, load_recipe
from quadsim.flight.scenario import changed
from quadsim.imu.spec import ImuSpec, load_imu
from scenarios.task.rotorpy_flights import DURATION_S as ROTORPY_S
from scenarios.task.rotorpy_flights import plans, rotorpy_flights

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


ADIS16448 = load_imu("adis16448")
PLANS = {airframe: plans(airframe, seed) for airframe, seed in (("hummingbird", 101), ("crazyflie", 201))}
"""The flights of each airframe."""
PLAN = (
    f"{sum(map(len, PLANS.values()))} flights of {ROTORPY_S:g} s of "
    "[RotorPy](https://github.com/spencerfolk/rotorpy)"
)
DESCRIPTION = (
    f"{PLAN}, a simulator by other authors. Vehicles (Hummingbird and Crazyflie), aerodynamics, wind, "
    "trajectories and controller are those of RotorPy. The IMU is our model"
)
"""Of the flights, for the pages."""


@cache
def rotorpy_sets(data: Path, imu: ImuSpec = ADIS16448) -> list[xr.Dataset]:
    """RotorPy's flights, a dataset for each of `PLANS`; they are stored in the folder of the datasets."""
    return [rotorpy_flights(plans, data / "rotorpy", imu) for plans in PLANS.values()]
