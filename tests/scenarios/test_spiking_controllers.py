"""The controllers that ship fly gentle scenarios beside the cascade on the same estimator."""

import pytest

from estimators.networks.weights_file import shipped_controllers
from quadsim.flight.scenario import load_scenario
from scenarios.bench.cell import FlightSettings, fly_cell

ESTIMATOR = "att-snn-hummingbird"
FACTOR = 1.5
"""Of the cascade's tracking error, at most."""


def tracking(scenario, controller, estimator):
    """Of the cascade and of a controller, on the same estimator [deg]."""
    settings = FlightSettings(4)
    names = (estimator, f"{estimator} @ {controller}")
    cascade, spiking = (fly_cell(scenario, load_scenario(scenario), name, settings) for name in names)
    assert spiking.row.crashes == 0
    return cascade.row.attitude_deg, spiking.row.attitude_deg


@pytest.mark.slow
@pytest.mark.parametrize("controller", shipped_controllers())
@pytest.mark.parametrize("scenario", ["hover", "step", "wind-5"])
def test_a_controller_flies_without_a_crash_and_tracks_as_the_cascade_does(scenario, controller):
    cascade, spiking = tracking(scenario, controller, ESTIMATOR)
    assert spiking < FACTOR * cascade


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["hover", "step", "wind-8", "dryden-moderate"])
def test_on_the_true_attitude_a_controller_tracks_within_a_third_of_the_cascade(scenario):
    cascade, spiking = tracking(scenario, "control-attitude", "truth")
    assert spiking < 1.3 * cascade


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["dropouts", "saturation", "stuck", "clipping"])
def test_bad_readings_leave_its_commands_finite(scenario):
    """Missing, saturated and stuck samples: the flight's numbers stay finite, crash or not."""
    name = f"{ESTIMATOR} @ {shipped_controllers()[0]}"
    cell = fly_cell(scenario, load_scenario(scenario), name, FlightSettings(2))
    assert not cell.reason
    assert max(flight.jitter for flight in cell.flights) < 200.0
