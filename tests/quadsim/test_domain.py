"""Domain randomisation, in environments and datasets, and other vehicles in the environment."""

import gymnasium
import numpy as np
import pytest

import quadsim  # noqa: F401  registers the environment
from quadsim.flight.faults import PayloadDrop
from quadsim.flight.mission import Mission
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed, load_scenario
from quadsim.flight.simulate import simulate_flights
from quadsim.imu.spec import RANDOM, load_imu, randomise_imu
from quadsim.seeding import vehicle_seeds
from quadsim.vehicle import Randomisation, load_vehicle

ID = "quadsim/Quadrotor-v0"
EVERY = {name: 0.4 for name in Randomisation.model_fields}
WINDY = changed(
    load_scenario("hover"), {"wind": ({"kind": "constant", "velocity": (3.0, 0.0, 0.0)},), "duration_s": 0.1}
)


def begun(n=40, engine="auto", **spread):
    mission = Mission(changed(WINDY, {"randomisation": spread, "engine": engine}), n=n)
    mission.begin(vehicle_seeds(3, n))
    return mission


def numbers(mission):
    """What each flight has over its nominal value, by the part of the randomisation that draws it."""
    nominal, p = load_vehicle(mission.scenario.vehicle), mission.plant.vehicles
    mass = p["mass"] / nominal.mass
    return {
        "mass": mass,
        "inertia": p["inertia"][:, 0] / nominal.inertia[0] / mass,
        "thrust": p["k_f"] / nominal.motor.k_f,
        "torque": p["k_m"] / nominal.motor.k_m,
        "rotor_drag": p["rotor_drag"] / nominal.motor.rotor_drag,
        "frame_drag": p["frame_drag"][:, 0] / p["frame_drag"][:, 0].mean(),
        "motor_lag": p["tau_up"] / nominal.motor.tau_up,
        "imu": mission.imu.records["white"][:, 0] / (load_imu("adis16448").gyro.noise * np.sqrt(200.0)),
        "wind": mission.plans["wind"][:, 0, 0] / 3.0,
        "delay": mission.external.sensors["delay"] / 2.0,
    }


@pytest.mark.parametrize("name", EVERY)
def test_a_spread_changes_the_number_that_it_names_and_no_other(name):
    for each, found in numbers(begun(**{name: 0.4})).items():
        assert (np.ptp(found) > 0.4) == (each == name)
        assert found == pytest.approx(np.ones(40), abs=0.51 if each == name else 1e-9)  # a delay is rounded


def test_a_flight_depends_on_its_seed_and_not_on_the_flights_beside_it():
    few, many = numbers(begun(2, **EVERY)), numbers(begun(5, **EVERY))
    for name in EVERY.keys() - {"frame_drag"}:
        np.testing.assert_array_equal(few[name], many[name][:2])


def test_every_error_of_an_imu_has_a_factor_of_its_own():
    worst = load_imu("rough")
    drawn = randomise_imu(worst, 0.3, np.random.default_rng(0))
    ratios = [
        getattr(new, name) / getattr(old, name)
        for new, old in zip(drawn.sensors.values(), worst.sensors.values(), strict=True)
        for name in RANDOM
    ]
    assert len(set(np.round(ratios, 9))) == 2 * len(RANDOM)
    assert np.abs(np.array(ratios) - 1.0).max() < 0.3


def test_a_drawn_delay_is_the_age_of_what_the_external_sensor_says(tmp_path):
    file = tmp_path / "slow.toml"
    file.write_text("delay_s = 0.05\n")  # ten samples
    changes = {"external": str(file), "randomisation": {"delay": 1.0}, "start": {"speed": 5.0}}
    mission = Mission(changed(WINDY, changes), n=10)
    mission.begin(vehicle_seeds(0, 10))
    true = []
    for _ in range(40):
        mission.step()
        true.append(mission.plant.position.copy())
    delays = mission.external.sensors["delay"]
    assert delays.min() < 5
    assert delays.max() > 15
    for flight, delay in enumerate(delays):
        np.testing.assert_array_equal(mission.measured_state["position"][flight], true[-1 - delay][flight])


@pytest.mark.parametrize("engine", ["auto", "mujoco"])
def test_a_restart_draws_one_vehicle_again_and_leaves_the_others(engine):
    mission = begun(3, engine, **EVERY)
    before = numbers(mission)
    mission.restart(np.array([1]), vehicle_seeds(9, 1))
    mission.sense()
    for name, now in numbers(mission).items():
        if name != "frame_drag":
            assert (now != before[name]).tolist() == [False, True, False], name
    if engine == "mujoco":
        body = mission.plant.engine.batch.expand("body_mass")[:, 1]
        np.testing.assert_array_equal(body, mission.plant.vehicles["mass"])


def test_a_payload_comes_on_top_of_each_vehicles_own_mass():
    fault = PayloadDrop(kind="payload-drop", mass=0.2, at_s=0.05)
    mission = Mission(changed(WINDY, {"randomisation": {"mass": 0.3}, "faults": (fault,)}), n=2)
    mission.begin(vehicle_seeds(0, 2))
    for seed in (1, 2):
        own = mission.plant.vehicles["mass"].copy()
        mission.step()
        assert mission.plant.vehicles["mass"] == pytest.approx(own + 0.2)
        for _ in range(15):
            mission.step()
        assert mission.plant.vehicles["mass"] == pytest.approx(own)
        mission.restart(np.arange(2), vehicle_seeds(seed, 2))
        mission.sense()
        assert (mission.plant.vehicles["mass"] != own).all()


def test_reset_randomises_until_the_next_reset():
    env = gymnasium.make_vec(ID, 3, scenario=WINDY)
    env.reset(seed=1, options={"randomisation": {"mass": 0.3}})
    assert len(set(env.mission.plant.vehicles["mass"])) == 3
    env.reset(seed=1)
    assert len(set(env.mission.plant.vehicles["mass"])) == 1


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"mas": 0.1}, 'unknown key "randomisation.mas"; did you mean "mass"'),
        ({"delay": 1.5}, r"randomisation.delay = 1.5: should be less than or equal to 1"),
        (0.1, "randomisation = 0.1"),
    ],
)
def test_a_wrong_spread_is_named(given, text):
    with pytest.raises(ValueError, match=text):
        gymnasium.make(ID, randomisation=given)
    with pytest.raises(ValueError, match=text):
        gymnasium.make_vec(ID, 2).reset(options={"randomisation": given})


def test_a_recipe_spreads_the_imu_and_the_wind_of_its_flights():
    base = load_recipe("turbulent").model_copy(update={"warmup_s": 0.0, "randomisation": Randomisation()})
    seeds = vehicle_seeds(0, 2)
    plain = simulate_flights(base, seeds, 50)
    for spread, differ in (
        ({"imu": 0.5}, {"gyro", "accel", "gyro_bias", "accel_bias"}),
        ({"wind": 0.5}, {"wind", "position", "gyro", "accel"}),
    ):
        varied = simulate_flights(changed(base, {"randomisation": spread}), seeds, 50)
        found = {name for name in plain if not np.array_equal(varied[name], plain[name])}
        assert found >= differ
        assert ("imu" in spread) == ("position" not in found)
    factor = varied["wind"] / plain["wind"]
    np.testing.assert_allclose(factor, np.broadcast_to(factor[:, :1, :1], factor.shape))
    with pytest.raises(ValueError, match="a dataset has no external sensor"):
        changed(base, {"randomisation": {"delay": 0.5}})
