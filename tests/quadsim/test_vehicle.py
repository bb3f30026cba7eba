from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadsim.config.toml import preset_names
from quadsim.control.gains import PHASE_MARGIN_DEG, design, loop_margins
from quadsim.vehicle import Randomisation, load_vehicle, randomise

VEHICLES = preset_names("vehicles")


def test_hummingbird_has_the_published_derived_numbers():
    vehicle = load_vehicle("hummingbird")
    assert vehicle.hover_rotor_vel == pytest.approx(453.2, abs=0.05)
    assert vehicle.thrust_to_weight == pytest.approx(3.42, abs=0.005)
    assert vehicle.drag_time_constant == pytest.approx(4.90, abs=0.005)


@pytest.mark.parametrize("name", VEHICLES)
def test_shipped_gains_are_what_the_design_gives_and_keep_every_phase_margin(name):
    vehicle = load_vehicle(name)
    assert vehicle.controller is not None
    assert vehicle.controller.model_dump() == pytest.approx(design(vehicle).model_dump(), rel=1e-3)
    margins = loop_margins(vehicle, vehicle.controller)
    for loop, wanted in PHASE_MARGIN_DEG.items():
        assert margins[loop].phase_deg == pytest.approx(wanted, abs=0.2)
        assert margins[loop].gain_db > 6.0


def test_a_delay_that_no_gain_can_bear_is_refused():
    with pytest.raises(ValueError, match="delays are too long"):
        design(load_vehicle("hummingbird"), estimator_delay=100.0)


@given(st.integers(0, 2**32 - 1))
def test_randomised_vehicles_stay_within_their_spread_and_are_rigid_bodies(seed):
    spread = Randomisation(
        mass=0.2, inertia=0.2, thrust=0.1, torque=0.1, rotor_drag=0.5, frame_drag=0.5, motor_lag=0.3
    )
    nominal = load_vehicle("hummingbird")
    assert randomise(nominal, Randomisation(), np.random.default_rng(seed)) == nominal
    drawn = randomise(nominal, spread, np.random.default_rng(seed))
    assert abs(drawn.mass / nominal.mass - 1) <= 0.2
    assert abs(drawn.motor.k_f / nominal.motor.k_f - 1) <= 0.1
    a, b, c = sorted(drawn.inertia)
    assert a + b >= c


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (("inertia = [0.007, 0.007, 0.012]", "inertia = [0.001, 0.001, 0.012]"), "triangle"),
        (("omega_max = 838.0", "omega_max = 300.0"), "thrust-to-weight"),
    ],
)
def test_a_wrong_vehicle_file_is_one_clear_line(tmp_path, edit, message):
    text = (files("assets") / "vehicles" / "hummingbird.toml").read_text()
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(*edit))
    with pytest.raises(ValueError, match=message) as caught:
        load_vehicle(path)
    assert "\n" not in str(caught.value)
    assert "mine.toml" in str(caught.value)
