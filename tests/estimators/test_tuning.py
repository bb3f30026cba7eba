"""The searches, the cost they lower, and the files they end in."""

import json
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from filter_cases import COMPILED
from own_estimator import MINE

from estimators import create, parameters, run_batch
from estimators.evaluation.flights import load_flights
from estimators.filters.samples import squared_error
from estimators.metrics import absolute_error
from estimators.registry import airframe_constants
from estimators.tuned import Tuned, load_tuning
from estimators.tuning.search import (
    PENALTY,
    SearchSettings,
    evolution,
    flown_on,
    imu_constants,
    mean_squared_error,
    swarm,
    tunable,
    tune,
    write_tuning,
)
from quadsim.flight.recipe import load_recipe
from quadsim.vehicle import load_vehicle


def bowl(x):
    """Two valleys; the lower one, at 0.7, is the narrower."""
    return np.sum((x - 0.3) ** 2, axis=1) + 0.02 - 0.05 * np.exp(-50.0 * np.sum((x - 0.7) ** 2, axis=1))


@pytest.mark.parametrize("search", [swarm, evolution])
def test_searches_find_the_lowest_point(search):
    asked = []

    def cost(x):
        asked.extend(x)
        return np.sum((x - [0.2, 0.9]) ** 2, axis=1)

    found = search(cost, [0.5, 0.5], SearchSettings(particles=60, iterations=60, seed=1))
    np.testing.assert_allclose(found.position, [0.2, 0.9], atol=0.02)
    assert found.cost == pytest.approx(np.sum((found.position - [0.2, 0.9]) ** 2))
    assert found.evaluations == len(asked)


def test_swarm_starts_again_from_its_seed_and_reports_the_lowest_cost():
    seen, first = [], np.full(3, 0.5)
    again, once = (swarm(bowl, first, SearchSettings(particles=20, iterations=8, seed=5)) for _ in range(2))
    np.testing.assert_array_equal(again.position, once.position)
    other = SearchSettings(particles=20, iterations=8, seed=6)
    another = swarm(bowl, first, other, lambda *each: seen.append(each))
    assert not np.array_equal(once.position, another.position)
    assert [(i, n) for i, n, _ in seen] == [(i + 1, 8) for i in range(8)]
    costs = [cost for _, _, cost in seen]
    assert costs == sorted(costs, reverse=True)


def test_outside_the_cube_costs_ten_more_and_is_scored_at_the_edge():
    """With the lowest cost at a corner, particles leave the cube; none of them may win by it."""
    asked = []

    def cost(x):
        asked.append(x)
        return x.sum(axis=1)

    found = swarm(cost, [0.5, 0.5], SearchSettings(particles=30, iterations=40, seed=0))
    assert np.min(asked) >= 0.0
    assert np.max(asked) <= 1.0
    assert 0.0 <= found.cost < 0.1 < PENALTY


@pytest.mark.parametrize(
    "angles",
    [(1e20, 0.1), (0.1, 1e20), (3.1, 6.2), (-3.1, -6.2), (0.1, 3.5), (math.nan, 0.0), (math.inf, math.nan)],
)
def test_the_compiled_cost_counts_angles_as_the_metrics_do(angles):
    truth = np.array([-3.0, 0.2])
    squares = np.radians(absolute_error(np.array(angles), truth)) ** 2
    both = np.array([[truth], [[math.nan, math.nan]]])
    found = squared_error(np.tile(angles, (2, 1, 1)), both)
    np.testing.assert_allclose(found, [squares.sum(), 0.0])


@pytest.mark.parametrize("name", COMPILED)
def test_sets_are_scored_as_they_run(flights, name):
    """Samples are missing in every way; both starts."""
    data = load_flights([flights.isel(time=slice(400))], 2)
    data.gyro[0, 100:103], data.accel[0, 150], data.accel[1, 200:210] = np.nan, np.nan, 0.0
    rng, constants = np.random.default_rng(0), airframe_constants(name, load_vehicle("hummingbird"))
    searched = {key: each for key, each in parameters(name).items() if each.searched}
    sets = {key: each.at(rng.uniform(0.2, 0.8, 4)) for key, each in searched.items()}
    sets |= {key: np.full(4, value) for key, value in constants.items()}
    for start in (data, data.known()):
        cost = mean_squared_error(name, sets, start, workers=2)
        np.testing.assert_array_equal(cost, mean_squared_error(name, sets, start))
        estimate = run_batch(name, sets, start.gyro, start.accel, start.rate_hz, start.start)
        error = np.radians(absolute_error(estimate, start.truth[None].repeat(4, 0)))
        np.testing.assert_allclose(cost, (error**2).mean(axis=(1, 2, 3)), rtol=1e-9)


def test_samples_after_the_end_of_a_flight_are_not_scored(flights):
    ended = flights.assign(valid_steps=("flight", np.array([4000, 1000, 4000, 4000])))
    data = load_flights([ended])
    assert np.isnan(data.truth[1, 1000:]).all()
    assert np.isfinite(data.truth[1, :1000]).all()
    assert np.isfinite(mean_squared_error("mahony", {"k_p": [0.3]}, data)).all()


@pytest.mark.parametrize("name", [*COMPILED, "vqf"])
def test_a_position_in_the_search_is_the_inverse_of_its_value(name):
    for each in parameters(name).values():
        for x in (0.0, 0.3, 1.0):
            assert each.position(float(each.at(x))) == pytest.approx(x, abs=1e-12)


def test_pieces_are_the_flights_started_anew_in_motion(flights):
    whole = load_flights([flights], 2)
    cut = whole.pieces(3)
    assert cut.gyro.shape == (6, 1333, 3)
    np.testing.assert_array_equal(cut.truth[4], whole.truth[1, 1333:2666])
    assert cut.start is None
    with pytest.raises(ValueError, match="pieces: 5000 of flights of 4000 samples"):
        whole.pieces(5000)


@pytest.mark.parametrize("name", ["complementary", "eskf", "vqf"])
def test_tuning_lowers_the_error(flights, name):
    data = load_flights([flights], 2)
    spec = parameters(name)
    default = {key: np.array([each.default]) for key, each in spec.items()}
    before = float(np.degrees(np.sqrt(mean_squared_error(name, default, data)[0])))
    tuned = tune(name, [flights], SearchSettings(particles=12, iterations=5), flights=2)
    assert tuned.rmse_deg <= before + 1e-5  # the default is among those tried
    assert tuned.evaluations == 60


def test_tuned_file_is_what_create_reads(flights, tmp_path):
    path, search = tmp_path / "sub" / "mine.toml", SearchSettings(particles=6, iterations=2)
    for name, comment in (("mahony", "Found in a test."), ("madgwick", "Found again.")):
        tuned = tune(name, [flights], search, flights=1, command=f'tune "{name}"')
        write_tuning(path, name, tuned, comment)
    tables = load_tuning(path)
    assert path.read_text().startswith("# Found in a test.\n")
    assert list(tables) == ["mahony", "madgwick"]
    assert tables["mahony"].command == 'tune "mahony"'
    est = create("mahony", tuning=path)
    assert est.values == tables["mahony"].values
    assert create("mahony", tuning=path, k_p=0.5).values["k_p"] == 0.5
    with pytest.raises(ValueError, match=r"no table \[ekf\]; it has mahony, madgwick"):
        create("ekf", tuning=path)


def test_filters_that_are_tuned_at_once_all_stand_in_the_file(tmp_path):
    path, names = tmp_path / "mine.toml", ["mahony", "madgwick", "eskf", "imm", "vqf", "complementary"]
    tuned = Tuned(command="by hand", rate_hz=200.0, rmse_deg=1.0, evaluations=1, values={})
    with ThreadPoolExecutor(len(names)) as pool:
        list(pool.map(lambda name: write_tuning(path, name, tuned, ""), names))
    assert set(load_tuning(path)) == set(names)


def test_filterpys_filters_take_the_values_of_ekf(flights, tmp_path):
    path = tmp_path / "mine.toml"
    tuned = tune("ekf", [flights], SearchSettings(particles=4, iterations=1), flights=1)
    write_tuning(path, "ekf", tuned, "")
    tables = load_tuning(path)
    assert set(tables) == {"ekf", "ekf-filterpy", "ukf-filterpy"}
    assert tables["ukf-filterpy"].values == tables["ekf"].values
    assert "ekf" in tunable()
    assert "ukf-filterpy" not in tunable()


def test_gain_of_a_sample_is_carried_over_to_another_rate(tmp_path, flights):
    path = tmp_path / "mine.toml"
    tuned = tune("complementary", [flights], SearchSettings(particles=4, iterations=1))
    write_tuning(path, "complementary", tuned, "")
    fast, slow = (create("complementary", rate, tuning=path).values["gamma"] for rate in (200.0, 50.0))
    assert slow == pytest.approx(fast**4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[mahony]\nk_p = 1.0", 'unknown key "mahony.k_p"; valid: command, vehicle'),
        (
            '[mahony]\ncommand = ""\nrate_hz = 200.0\nrmse_deg = 1.0\nevaluations = 1\n'
            "[mahony.values]\nkp = 1.0",
            'no parameter "kp"; did you mean "k_p"',
        ),
    ],
)
def test_a_broken_tuning_file_is_named(tmp_path, text, message):
    path = tmp_path / "broken.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"broken\.toml") as caught:
        create("mahony", tuning=path)
    assert message in str(caught.value)


def test_shipped_parameters_are_the_defaults():
    shipped = load_tuning("hummingbird-adis16448")
    for name, table in shipped.items():
        if not name.endswith("filterpy"):
            est = create(name, table.rate_hz, vehicle="hummingbird")
            assert est.values.items() >= table.values.items()


def test_estimators_without_parameters_and_broken_datasets_are_named(flights):
    for name, datasets, message in (
        ("truth", [flights], "truth has no parameters to tune"),
        ("mahony", [flights.drop_vars("quat")], "the dataset has no quat"),
        ("mahony", [flights, flights.isel(time=slice(100))], "must agree in length and sample rate"),
    ):
        with pytest.raises(ValueError, match=message):
            tune(name, datasets)


OWN = f"""{MINE}
class Sometimes(Mine):
    def spoiled(self, angle):
        return np.full_like(angle, 1e20) if self.gain < 0.02 else 0 * angle if self.gain < 0.1 else angle

class Never(Mine):
    def spoiled(self, angle):
        return angle * np.nan

class Peeks(Mine):
    def observe(self, quat):
        pass
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)


@pytest.mark.parametrize("method", ["swarm", "evolution"])
def test_parameters_whose_estimates_have_a_flaw_do_not_win(flights, own, method):
    part = flights.isel(time=slice(400))
    found = tune("own.py:Sometimes", [part], SearchSettings(method, 6, 2, seed=1))
    assert found.values["gain"] >= 0.1
    assert found.rmse_deg < 90.0


@pytest.mark.parametrize("method", ["swarm", "evolution"])
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("Never", "no parameters of own.py:Never give estimates that can be scored: it returned roll or"),
        ("Peeks", "own.py:Peeks receives the true attitude: there is nothing to tune"),
    ],
)
def test_an_estimator_that_no_parameters_make_sound_is_refused(flights, own, name, text, method):
    with pytest.raises(ValueError, match=text):
        tune(f"own.py:{name}", [flights.isel(time=slice(400))], SearchSettings(method, 4, 2))


def test_a_dataset_that_does_not_say_its_imu_tunes_ekf_drag_with_the_defaults(flights):
    config = json.loads(load_recipe("hummingbird").model_dump_json())
    imu = config["imu"]
    assert imu_constants("ekf-drag", flights.assign_attrs(config=json.dumps(config))) == {
        "bias_sigma": imu["gyro"]["turn_on"],
        "accel_bias_sigma": imu["accel"]["turn_on"],
    }
    del config["imu"]
    without = flights.assign_attrs(config=json.dumps(config))
    assert imu_constants("ekf-drag", without) == {}
    assert flown_on([without])["imu"] == ""
