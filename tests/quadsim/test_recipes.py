"""Shipped recipes: their flights complete, and those drawn wide reach what their descriptions name."""

import numpy as np
import pytest

from quadsim.config.toml import preset_names
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed
from quadsim.flight.simulate import simulate_flights
from quadsim.seeding import vehicle_seeds
from quadsim.vehicle import load_vehicle, randomise

RATE = 200.0


def simulate(recipe, n, duration_s, **changes):
    config = changed(load_recipe(recipe), changes)
    return simulate_flights(config, vehicle_seeds(0, n), round(duration_s * RATE))


WIDE = ["wide", "cruise"]


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


def test_most_cruises_exceed_12_m_s():
    speed = np.linalg.norm(simulate("cruise", 12, 60.0)["velocity"], axis=-1)
    assert np.mean(speed.max(axis=1) > 12.0) > 0.5
