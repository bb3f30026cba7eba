"""Shipped recipes: their flights complete, and those drawn wide reach what their descriptions name."""

import numpy as np
import pytest

from quadsim.config.toml import preset_names
from quadsim.flight.hand_held import HandHeld
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed
from quadsim.flight.simulate import simulate_flights
from quadsim.rotation import quat_rotate_inverse
from quadsim.seeding import vehicle_seeds
from quadsim.vehicle import load_vehicle, randomise

RATE = 200.0


def simulate(recipe, n, duration_s, **changes):
    config = changed(load_recipe(recipe), changes)
    return simulate_flights(config, vehicle_seeds(0, n), round(duration_s * RATE))


WIDE = ["wide", "cruise"]
CARRIED = HandHeld(rate_deg_s=(3.0, 30.0), acceleration=(0.1, 6.0), move_s=(3.0, 20.0), rest_s=(1.0, 15.0))
TUMBLING = HandHeld(
    rate_deg_s=(120.0, 350.0), acceleration=(0.5, 12.0), move_s=(3.0, 20.0), rest_s=(0.5, 10.0)
)
GATES = """
[trajectory]
kind = "waypoints"
random_points = 10
box = [8.0, 8.0, 2.0]
position = [0.0, 0.0, 10.0]
speed = 3.5
[[wind]]
kind = "gust"
velocity = [5.0, 2.0, 0.5]
start = 6.0
rise = 0.4
hold = 3.0
[[wind]]
kind = "sinusoid"
amplitude = [1.0, 1.0, 0.0]
period_s = [2.0, 15.0]
[attitude_error]
sd_deg = 3.0
time_s = 0.3
[randomisation]
mass = 0.05
inertia = 0.05
thrust = 0.05
torque = 0.1
rotor_drag = 0.2
frame_drag = 0.3
motor_lag = 0.2
"""


@pytest.mark.parametrize(
    ("recipe", "changes"),
    [
        *((recipe, {}) for recipe in preset_names("recipes")),
        *((recipe, {"vehicle": each}) for recipe in WIDE for each in preset_names("vehicles")),
    ],
)
def test_flights_of_recipes_are_complete_of_wide_ones_on_every_vehicle(recipe, changes):
    assert set(simulate(recipe, 4, 20.0, **changes)["end_reason"]) == {""}


@pytest.mark.parametrize("recipe", WIDE)
def test_wide_recipes_draw_drags_and_masses_of_many_airframes(recipe):
    spread, rng = load_recipe(recipe).randomisation, np.random.default_rng(0)
    vehicles = map(load_vehicle, preset_names("vehicles"))
    drawn = [randomise(vehicle, spread, rng) for vehicle in vehicles for _ in range(200)]
    drag = [1.0 / vehicle.drag_time_constant for vehicle in drawn]
    mass = [vehicle.mass for vehicle in drawn]
    assert 0.05 < min(drag) < 0.1
    assert 0.6 < max(drag) < 0.9
    assert min(mass) < 0.03
    assert max(mass) > 1.9


def test_racing_lines_of_an_own_file_are_flown_through_gusts_on_a_wrong_attitude(tmp_path):
    (tmp_path / "gates.toml").write_text(GATES)
    flights = simulate(tmp_path / "gates.toml", 4, 20.0)
    assert set(flights["end_reason"]) == {""}
    reach = np.abs(flights["position"] - [0.0, 0.0, 10.0]).max(axis=(0, 1))
    assert np.all((reach > [5.0, 5.0, 1.0]) & (reach < [13.0, 13.0, 5.0]))
    assert np.ptp(flights["position"][:, -1], axis=0).max() > 3.0
    seconds = np.arange(4000) / RATE + 4.0  # after the warm-up
    gust = flights["wind"][:, (seconds > 6.5) & (seconds < 9.3)] - [5.0, 2.0, 0.5]
    assert np.abs(gust).max() < 1.0 + 1e-9
    assert np.abs(flights["wind"][:, seconds > 10.0]).max() < 1.0 + 1e-9
    exact = simulate(tmp_path / "gates.toml", 4, 20.0, attitude_error={})
    turned = [tilt_deg(each["quat"]) for each in (flights, exact)]
    assert 0.5 < np.std(turned[0] - turned[1]) < 5.0


def test_most_cruises_exceed_12_m_s():
    speed = np.linalg.norm(simulate("cruise", 12, 60.0)["velocity"], axis=-1)
    assert np.mean(speed.max(axis=1) > 12.0) > 0.5


def tilt_deg(quat):
    return np.degrees(np.arccos(np.clip(quat_rotate_inverse(quat, [0.0, 0.0, 1.0])[..., 2], -1.0, 1.0)))


def test_hands_range_from_carried_near_level_to_tumbling_beyond_10_rad_s():
    carried, tumbling = (simulate("hand-held", 20, 60.0, hand_held=spec) for spec in (CARRIED, TUMBLING))
    slow, fast = (np.linalg.norm(motion["ang_vel"], axis=-1) for motion in (carried, tumbling))
    assert np.median(tilt_deg(carried["quat"])) < 30.0
    assert np.median(tilt_deg(tumbling["quat"])) > 60.0
    assert np.mean(slow.max(axis=1) < 2.0) > 0.9
    assert np.mean(fast.max(axis=1) > 10.0) > 0.5
    assert all(0.1 < np.mean(rate == 0.0) < 0.6 for rate in (slow, fast))
