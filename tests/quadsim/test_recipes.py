"""Shipped recipes: their flights complete, and those drawn wide reach what their descriptions name."""

import numpy as np
import pytest

from quadsim.config.toml import preset_names
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed
from quadsim.flight.simulate import simulate_flights
from quadsim.rotation import quat_rotate_inverse
from quadsim.seeding import vehicle_seeds
from quadsim.vehicle import load_vehicle, randomise
from quadsim.wind import wind_series

RATE = 200.0


def simulate(recipe, n, duration_s, **changes):
    return simulate_flights(
        changed(load_recipe(recipe), changes), vehicle_seeds(0, n), round(duration_s * RATE)
    )


WIDE = ["wide", "fast-wind", "cruise"]


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
    drawn = [
        randomise(load_vehicle(name), spread, rng) for name in preset_names("vehicles") for _ in range(200)
    ]
    drag = [1.0 / vehicle.drag_time_constant for vehicle in drawn]
    mass = [vehicle.mass for vehicle in drawn]
    assert 0.05 < min(drag) < 0.1
    assert 0.6 < max(drag) < 0.9
    assert min(mass) < 0.03
    assert max(mass) > 1.9


def test_fast_wind_changes_in_3_s_as_much_as_it_ever_does_apart_from_its_mean():
    def changes(recipe, lag_s):
        wind = wind_series(load_recipe(recipe).wind, 40, 60 * 200, RATE, 0)[..., :2]
        lag = round(lag_s * RATE)
        return np.sqrt(np.mean((wind[:, lag:] - wind[:, :-lag]) ** 2))

    assert changes("fast-wind", 3.0) > 0.85 * changes("fast-wind", 10.0)
    assert changes("fast-wind", 3.0) > 2.0 * changes("turbulent", 3.0)


def test_most_cruises_exceed_12_m_s():
    speed = np.linalg.norm(simulate("cruise", 12, 60.0)["velocity"], axis=-1)
    assert np.mean(speed.max(axis=1) > 12.0) > 0.5


def tilt_deg(quat):
    return np.degrees(np.arccos(np.clip(quat_rotate_inverse(quat, [0.0, 0.0, 1.0])[..., 2], -1.0, 1.0)))


def test_hands_range_from_carried_near_level_to_tumbling_beyond_10_rad_s():
    carried, tumbling = (simulate(recipe, 20, 60.0) for recipe in ("carried", "tumbling"))
    slow, fast = (np.linalg.norm(motion["ang_vel"], axis=-1) for motion in (carried, tumbling))
    assert np.median(tilt_deg(carried["quat"])) < 30.0
    assert np.median(tilt_deg(tumbling["quat"])) > 60.0
    assert np.mean(slow.max(axis=1) < 2.0) > 0.9
    assert np.mean(fast.max(axis=1) > 10.0) > 0.5
    assert all(0.1 < np.mean(rate == 0.0) < 0.6 for rate in (slow, fast))
