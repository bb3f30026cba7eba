"""Flights of RotorPy, a simulator by other authors, on which pages score estimators.

They are simulated where they are missing, about three minutes of CPU time. Nothing was trained or tuned on
them.
"""

from functools import cache
from pathlib import Path

import xarray as xr

from quadsim.imu.spec import ImuSpec, load_imu
from scenarios.task.rotorpy_flights import DURATION_S, plans, rotorpy_flights

ADIS16448 = load_imu("adis16448")
PLANS = {airframe: plans(airframe, seed) for airframe, seed in (("hummingbird", 101), ("crazyflie", 201))}
"""The flights of each airframe."""
PLAN = (
    f"{sum(map(len, PLANS.values()))} flights of {DURATION_S:g} s of "
    "[RotorPy](https://github.com/spencerfolk/rotorpy)"
)
DESCRIPTION = (
    f"{PLAN}, a simulator by other authors: its Hummingbird and "
    "Crazyflie, its aerodynamics, wind, trajectories and controller, with our model of the IMU"
)
"""Of the flights, for the pages."""


@cache
def foreign(data: Path, imu: ImuSpec = ADIS16448) -> list[xr.Dataset]:
    """RotorPy's flights, a dataset for each of `PLANS`; they are stored in the folder of the datasets."""
    return [rotorpy_flights(plans, data / "rotorpy", imu) for plans in PLANS.values()]
