"""The controllers that ship fly gentle scenarios beside the cascade on the same estimator."""

import numpy as np
import pytest

from estimators.networks.weights_file import shipped_controllers
from quadsim.flight.scenario import changed, load_scenario
from scenarios.bench.cell import FlightSettings, fly_cell

ESTIMATOR = "att-snn"
MOST = {ESTIMATOR: 1.5, "truth": 1.3}
"""Tracking error over that of the cascade, at most."""


def flown(scenario, name):
    cell = fly_cell(scenario, changed(load_scenario(scenario), {"duration_s": 10.0}), name, FlightSettings(2))
    assert not cell.reason
    return cell


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["step", "wind-5"])
def test_a_controller_flies_without_a_crash_and_tracks_as_the_cascade_does(scenario):
    for estimator in (ESTIMATOR, "truth"):
        cascade = flown(scenario, estimator).flights
        for controller in shipped_controllers():
            spiking = flown(scenario, f"{estimator} @ {controller}").flights
            assert not any(flight["cause"] for flight in spiking)
            ours, theirs = (np.mean([each["attitude_deg"] for each in own]) for own in (spiking, cascade))
            assert ours < MOST[estimator] * theirs


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["dropouts", "saturation", "stuck"])
def test_bad_readings_leave_its_commands_finite(scenario):
    """Missing, saturated and stuck samples: the flight's numbers stay finite, crash or not."""
    cell = flown(scenario, f"{ESTIMATOR} @ {shipped_controllers()[0]}")
    assert max(flight["jitter"] for flight in cell.flights) < 200.0
