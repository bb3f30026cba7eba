"""The estimator imm, the flights that its tests generate, and its error on them."""

import numpy as np

from estimators import create, run
from estimators.filters.drag.imm import InteractingModels
from estimators.metrics import inclination_error
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed

RATE = 200.0
VARIED = changed(
    load_recipe("hummingbird"),
    {
        "trajectory": {
            "kind": "mix", "min_tilt_deg": 5.0, "max_tilt_deg": 40.0, "circle_s": (3.0, 9.0),
            "circle_share": 0.3, "jump_share": 0.3, "pause_share": 0.1, "radius": 30.0,
        },
        "randomisation": {
            "mass": 0.05, "inertia": 0.05, "thrust": 0.05, "rotor_drag": 0.1, "frame_drag": 0.2
        },
    },
)  # fmt: skip
"""Dashes, jumps and wide slow circles in still air on vehicles that vary."""


def imm(**params):
    est = create("imm", RATE, **params)
    assert isinstance(est, InteractingModels)
    return est


def rmse(est, gyro, accel, truth, after=10.0, **sensors):
    """Inclination RMSE from an unknown start [deg]."""
    error = inclination_error(run(est, gyro, accel, **sensors), truth)[:, round(after * RATE) :]
    return float(np.sqrt(np.mean(error**2)))
