"""Flights of RotorPy, a simulator by other authors, on which pages score estimators.

They are simulated where they are missing, about three minutes of CPU time. Nothing was trained or tuned on
them.
"""

from functools import cache
from pathlib import Path

import xarray as xr

from quadsim.imu.spec import ImuSpec, load_imu
from scenarios.task.rotorpy_flights import AIRFRAMES as AIRFRAMES
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
def foreign(airframe: str, data: Path, imu: ImuSpec = ADIS16448) -> xr.Dataset:
    """RotorPy's flights of an airframe as one of our datasets.

    Args:
        airframe: One of `AIRFRAMES`.
        data: Folder of the datasets; flights are stored in `rotorpy/` in it.
        imu: The IMU, which is switched on when recording begins.
    """
    return rotorpy_flights(PLANS[airframe], data / "rotorpy", imu)
