import re
import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from level import Level
from missions import HOVER, flown, with_faults

import estimators
from estimators.metrics import inclination_error
from quadsim.config.toml import parse
from quadsim.control.records import MEASURED
from quadsim.external import ExternalSensor, ExternalSpec, deliver
from quadsim.flight.loop import FlightLoop
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import Crash, Scenario, Start, changed, load_scenario
from quadsim.flight.world import CAUSES, GROUNDED, OUT_OF_BOUNDS, TILTED
from quadsim.rotation import roll_pitch_from_quat
from quadsim.seeding import vehicle_seeds
from quadsim.trajectory.specs import Hover
from quadsim.vehicle import load_vehicle, with_drag

FAULT = "[[faults]]\nat_s = 1.0\nkind = "


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ("[start]\ntilt = 20.0", 'unknown key "start.tilt"; did you mean "tilt_deg"'),
        (FAULT + '"thrust-loss"\neffect = 0.5\nrotor = 12', r"rotor = 12"),
        (
            FAULT + '"stuck"\nsensor = "gyroscope"',
            r"faults\[0\]\.sensor = .gyroscope.: should be 'both', 'gyro' or 'accel'",
        ),
        (FAULT + '"stuck"\naxes = "zx"', r"faults\[0\]\.axes = .zx.: should be 'x', .* or 'xyz'"),
        (FAULT + '"stuck"\naxes = ""', r"faults\[0\]\.axes = ..: should be"),
        (
            '[[faults]]\nkind = "saturation"\naccel = 3.0\nsensor = "gyro"',
            r"unknown key .faults\[0\]\.sensor",
        ),
        (FAULT + '"thrust-loss"\naxes = "x"', r"unknown key .faults\[0\]\.axes"),
    ],
)
def test_mistakes_are_named_with_file_and_key(toml, message):
    with pytest.raises(ValueError, match=f"^mine.toml: .*{message}") as error:
        parse(tomllib.loads('description = ""\n' + toml), Scenario, "mine.toml")
    assert "\n" not in str(error.value)


WORDS = st.text("ab_. é", max_size=4)
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.floats() | WORDS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=3),
    max_leaves=5,
)


@settings(deadline=None)
@given(st.dictionaries(st.sampled_from([*Scenario.model_fields, "speed", ""]), ANYTHING, max_size=4))
def test_any_content_is_a_scenario_or_one_clear_line(content):
    message = "mine.toml: it is a scenario"
    try:
        scenario = parse(content, Scenario, "mine.toml")
    except ValueError as error:
        message = str(error)
    else:
        assert scenario == Scenario.model_validate_json(scenario.model_dump_json())
    assert re.fullmatch("mine.toml: .+", message)


def test_a_flight_in_wind_does_not_notice_a_crash_beside_it():
    windy = changed(HOVER, {"duration_s": 1.5, "wind": [{"kind": "constant", "velocity": (6, 3, 0)}]})
    falling, holding = [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 9.81]
    positions = []
    for seeds, command in ((slice(0, 2), [falling, holding]), (slice(1, 2), [holding])):
        mission = Mission(windy, None, len(command))
        mission.begin(vehicle_seeds(0, 2)[seeds])
        for _ in range(mission.steps):
            mission.step("attitude", np.array(command))
        positions.append(mission.plant.position[-1].copy())
        assert (mission.cause[0] > 0) == (len(command) == 2)
    np.testing.assert_array_equal(*positions)


def test_starts_tilted_by_the_given_angle_about_an_axis_of_its_own():
    mission = Mission(HOVER.model_copy(update={"start": Start(tilt_deg=25.0)}), None, 4)
    mission.begin(vehicle_seeds(0, 4))
    quat = mission.plant.quat
    tilt = np.degrees(np.arccos(1 - 2 * (quat[:, 1] ** 2 + quat[:, 2] ** 2)))
    np.testing.assert_allclose(tilt, 25.0)
    assert len(np.unique(quat[:, 1])) == 4
    np.testing.assert_allclose(quat[:, 3], 0.0, atol=1e-12)


def test_an_attitude_is_given_wrongly_by_the_angle_that_is_asked_for():
    start = Start(known_attitude=True, attitude_error_deg=4.0, tilt_deg=30.0)
    mission = Mission(HOVER.model_copy(update={"start": start}), Level(), 50)
    mission.begin(vehicle_seeds(0, 50))
    given, truth = mission.estimator.start, mission.plant.roll_pitch
    np.testing.assert_allclose(inclination_error(given, truth), 4.0, atol=1e-6)
    off = given - truth
    assert np.abs(off.mean(axis=0)).max() < np.radians(2.0)  # about an axis of each flight's own


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_airframe_has_so_many_times_the_drag_of_its_file(factor):
    mission, known = Mission(HOVER.model_copy(update={"drag_factor": factor})), load_vehicle("hummingbird")
    assert mission.vehicle.drag_time_constant == pytest.approx(known.drag_time_constant / factor)
    np.testing.assert_allclose(mission.vehicle.frame.drag_area, factor * np.array(known.frame.drag_area))
    assert with_drag(known, 1.0) is known


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"start": Start(tilt_deg=80.0)}, TILTED),
        ({"trajectory": Hover(position=(0.0, 0.0, -0.5))}, GROUNDED),
        ({"start": Start(offset=(0.0, 0.0, 1.0)), "crash": Crash(distance=0.5)}, OUT_OF_BOUNDS),
    ],
)
def test_crashes_are_told_apart(change, cause):
    mission = flown(HOVER.model_copy(update=change))
    assert [CAUSES[c] for c in mission.cause] == [CAUSES[cause]] * 2


def test_a_flight_that_was_restarted_is_new():
    mission = flown(HOVER, 2)
    mission.cause[:] = TILTED
    mission.estimator = estimators.create("mahony")
    mission.estimator.reset(2, roll_pitch=np.full((2, 2), 0.3))
    mission.move()
    mission.restart(np.array([1]), vehicle_seeds(9, 1))
    np.testing.assert_allclose(
        roll_pitch_from_quat(mission.estimator.quat), [[0.3, 0.3], [0.0, 0.0]], atol=1e-9
    )
    mission.sense()
    assert mission.k.tolist() == [mission.steps + 1, 0]
    assert mission.cause.tolist() == [TILTED, 0]


def test_a_restarted_flight_has_its_rotors_and_its_mass_again():
    faults = [
        {"kind": "thrust-loss", "effect": 0.5, "at_s": 0.0, "fade_s": 0.1},
        {"kind": "payload-drop", "mass": 0.2, "at_s": 9.0},
    ]
    mission = flown(with_faults(*faults), 2)
    plant = mission.plant
    assert np.all(plant.rotor_effect < 1.0)
    mission.restart(np.array([1]), vehicle_seeds(9, 1))
    assert np.all(plant.rotor_effect[0] < 1.0)
    assert np.all(plant.rotor_effect[1] == 1.0)
    np.testing.assert_allclose(plant.vehicles["mass"] - mission.vehicle.mass, [0.2, 0.0], atol=1e-12)


def held(spec: ExternalSpec, samples: int, n: int = 2, restart: int = -1) -> np.ndarray:
    """What an external sensor at 100 Hz says of a vehicle at x = k, v = 2 k, yaw = 3 k; (samples, n, 7)."""
    sensor, state = ExternalSensor(spec, n, 100.0, 5), np.zeros(n, MEASURED)
    out = np.empty((samples, n, 7))
    for step in range(samples):
        state["k"] = step
        state["k"][0] = step if restart < 0 or step < restart else step - restart
        state["position"], state["velocity"], state["yaw"] = 1.0 * step, 2.0 * step, 3.0 * step
        for i in range(n):
            deliver(sensor.sensors[i], sensor.noise[i], sensor.queue[i], state[i])
        out[step] = np.column_stack([state["position"], state["velocity"], state["yaw"]])
    return out


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        (ExternalSpec(rate_hz=50.0, delay_s=0.03), [0, 0, 0, 0, 0, 2, 2, 4, 4, 6]),
        (ExternalSpec(rate_hz=30.0), [0, 0, 0, 0, 4, 4, 4, 7, 7, 7]),  # at 0, 3.33 and 6.67 samples
    ],
)
def test_external_sensor_holds_a_measurement_until_the_next_arrives(spec, said):
    out = held(spec, 10)[:, 0]
    np.testing.assert_array_equal(out[:, [0, 3, 6]], np.outer(said, [1, 2, 3]))


def test_external_sensor_starts_anew_with_a_restarted_vehicle():
    out = held(ExternalSpec(delay_s=0.02), 9, restart=5)
    np.testing.assert_array_equal(out[:, 0, 0], [0, 0, 0, 1, 2, 5, 5, 5, 6])
    np.testing.assert_array_equal(out[:, 1, 0], [0, 0, 0, 1, 2, 3, 4, 5, 6])


def noise_in_flight(n: int) -> np.ndarray:
    """What an external sensor adds to the truth in a flight, (samples, n, 7)."""
    spec = ExternalSpec(position_noise=0.1, velocity_noise=0.2, yaw_noise_deg=3.0)
    loop = FlightLoop(load_vehicle("hummingbird"), n, external=ExternalSensor(spec, n, 200.0, 5))
    loop.reset()
    noise = []
    for _ in range(3000):
        loop.step()
        m, p = loop.measured_state, loop.plant
        noise.append(np.c_[m["position"] - p.position, m["velocity"] - p.velocity, m["yaw"] - p.yaw])
    return np.array(noise)


def test_external_noise_has_its_size_and_a_vehicles_own_seed():
    noise = noise_in_flight(3)
    want = np.repeat([0.1, 0.2, np.radians(3.0)], [3, 3, 1])
    np.testing.assert_allclose(noise.std(axis=0), np.tile(want, (3, 1)), rtol=0.06)
    np.testing.assert_array_equal(noise[:, :1], noise_in_flight(1))
    assert abs(np.corrcoef(noise[:, 0, 0], noise[:, 1, 0])[0, 1]) < 0.06


def test_only_the_controller_is_misled_by_the_external_sensor():
    scenario = HOVER.model_copy(update={"external": "motion-capture"})
    ideal, real = flown(HOVER), flown(scenario)
    np.testing.assert_array_equal(ideal.measured_state["position"], ideal.plant.position)
    apart = np.abs(real.measured_state["position"] - real.plant.position)
    assert 0 < apart.max() < 0.01
    np.testing.assert_array_equal(real.attitude, real.plant.roll_pitch)


def test_stands_on_the_ground_and_takes_off():
    mission = Mission(load_scenario("take-off").model_copy(update={"duration_s": 8.0}), None, 1)
    mission.begin(vehicle_seeds(0, 1))
    height = []
    for _ in range(mission.steps):
        mission.step()
        height.append(mission.plant.position[0, 2])
    np.testing.assert_allclose(height[200:600], 0.03, atol=1e-3)
    assert height[-1] == pytest.approx(2.0, abs=0.03)
    assert mission.cause[0] == 0
