"""A vehicle's constants come back from its flights, and constants that flights do not determine are named."""

import numpy as np
import pytest

from quadsim.cli.identification import identify as identify_verb
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed
from quadsim.identify import identify, signals_of
from quadsim.identify.model import UNITS, constant, lagged, predicted, with_constants
from quadsim.vehicle import load_vehicle

TRUE = load_vehicle("hummingbird")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("identify")
    config = load_recipe("hummingbird")
    fast = config.model_copy(update={"trajectory": load_recipe("cruise").trajectory})
    each = ((config, "a"), (fast, "b"))
    return [generate(one, 1, 40.0, folder / f"{name}.zarr", seed=77, workers=1) for one, name in each]


@pytest.fixture(scope="module")
def flights(data):
    return [flight for path in data for flight in signals_of(open_dataset(path))]


def unsure(found):
    return set(found.constants.index[~found.constants.identified])


def test_constants_come_back_within_five_per_cent_from_noisy_flights(flights):
    found = identify(flights, with_constants(TRUE, {name: 0.7 * constant(TRUE, name) for name in UNITS}))
    assert list(found.constants.index) == list(UNITS)
    for path, fitted in found.constants.fitted[found.constants.identified].items():
        assert fitted == pytest.approx(constant(TRUE, path), rel=0.05), path
    assert unsure(found) <= {"frame.drag_area.0", "frame.drag_area.1", "frame.drag_area.2"}
    assert found.explained.min() > 0.98


def test_the_model_is_that_of_the_simulator(data):
    """On true signals of a flight, specific force and angular acceleration are the simulator's own."""
    one = open_dataset(data[0]).isel(flight=0)
    (flight,) = signals_of(open_dataset(data[0]))
    exact = flight._replace(gyro=one["ang_vel"].to_numpy().astype(float))
    force = predicted(TRUE, exact, exact.rotor_vel)[:, :3]
    np.testing.assert_allclose(force, one["specific_force"], atol=2e-4)


def test_commanded_speeds_lag_as_in_the_simulator(flights):
    speeds = lagged(TRUE, flights[0], flights[0].rotor_vel[0])
    np.testing.assert_allclose(speeds, flights[0].rotor_vel, rtol=1e-4, atol=0.01)


def test_what_hover_does_not_tell_keeps_its_value_and_is_named(tmp_path):
    breeze = {"kind": "dryden", "airspeed": 2.0, "altitude": 20.0, "wind_20ft": 1.5}
    config = changed(load_recipe("hummingbird"), {"trajectory": {"kind": "hover"}, "wind": [breeze]})
    path = generate(config, 1, 12.0, tmp_path / "hover.zarr", seed=1, workers=1)
    start = with_constants(config.vehicle, {"frame.drag_area.2": 0.5})
    found = identify(signals_of(open_dataset(path)), start)
    assert constant(found.vehicle, "frame.drag_area.2") == 0.5
    assert any(line.startswith("frame.drag_area.2: ") for line in found.missing)


def test_what_nothing_excites_is_not_identified(flights):
    """Commands that are met: no lag shows."""
    short = flights[0].part(0, 1200)
    met = short.rotor_vel.mean(0) + 0 * short.rotor_vel
    found = identify([short._replace(rotor_vel=met, rotor_vel_cmd=met)], TRUE)
    assert {"motor.tau_up", "motor.tau_down"} <= unsure(found)
    assert any(line.startswith("motor.tau_up: these flights do not determine it") for line in found.missing)
    assert found.vehicle.motor.tau_up == TRUE.motor.tau_up


def test_flights_of_two_rates_are_refused(flights):
    with pytest.raises(ValueError, match="200 Hz and 400 Hz; one rate"):
        identify([flights[0], flights[1]._replace(rate_hz=400.0)], TRUE)


def test_without_attitude_the_drag_is_not_fitted_and_without_speeds_nothing(flights):
    blind = [flight.part(0, 2000)._replace(air_vel=None) for flight in flights]
    found = identify(blind, TRUE)
    assert not any("drag" in path for path in found.constants.index)
    assert "drag: it needs attitude and position or velocity" in found.missing
    for none in ([], [flight._replace(rotor_vel=None, rotor_vel_cmd=None) for flight in flights]):
        with pytest.raises(ValueError, match="no 5 s without a missing sample and with rotor speeds"):
            identify(none, TRUE)
    with pytest.raises(ValueError, match="has 6 rotors, the flights 4"):
        identify(flights, load_vehicle("hexarotor"))


def test_the_command_writes_a_vehicle_and_a_picture_and_leaves_out_logs_without_rotor_speeds(
    data, tmp_path, quadsim, refused
):
    np.savez("log.npz", t=np.arange(1000) / 200, gyro=np.zeros((1000, 3)), acc=np.ones((1000, 3)))
    none = "no 5 s without a missing sample and with rotor speeds in rad/s"
    command = ["identify", "--rate", "200", "log.npz"]
    assert refused(*command) == f"quadsim: {none}"
    assert not (tmp_path / "mine.toml").exists()
    code, *said = quadsim(*command, *data)
    assert code == 0
    assert f"log.npz: {none}, left out" in "".join(said)
    assert "motor.k_f" in said[0]
    assert load_vehicle("mine.toml").motor.k_f == pytest.approx(TRUE.motor.k_f, rel=0.05)
    assert (tmp_path / "mine.png").is_file()


@pytest.mark.parametrize(("still", "kind"), [(True, "IMU"), (False, "vehicle")])
def test_a_file_of_another_kind_is_not_replaced(tmp_path, still, kind):
    other = tmp_path / "mine.toml"
    other.write_text('description = "a scenario"\n')
    with pytest.raises(ValueError, match=f"mine.toml exists and does not describe a {kind}"):
        identify_verb([tmp_path / "log.ulg"], out=other, still=still)
    assert other.read_text().startswith("description")
