"""Breaking points and paired differences."""

from dataclasses import fields

import numpy as np
import pytest

from quadsim.flight.scenario import load_scenario
from scenarios.bench import runner
from scenarios.bench.cell import Cell, FlightSettings, failed_cell
from scenarios.bench.experiment import load_experiment
from scenarios.bench.flight_metrics import FlightMetrics, FlightRow
from scenarios.bench.ranking import by_contender, paired_difference
from scenarios.bench.results import load_results
from scenarios.bench.runner import bench
from scenarios.bench.search import bisection

BREAKING = load_experiment("breaking-points")


def bracket(crashes, most, tolerance):
    search, tried = bisection(most, tolerance), []
    level = next(search)
    while True:
        tried.append(level)
        try:
            level = search.send(crashes(level))
        except StopIteration as end:
            return end.value, len(tried)


@pytest.mark.parametrize("true", [0.3, 7.77, 31.9])
def test_bisection_brackets_the_first_level_that_crashes(true):
    (low, high), tried = bracket(lambda level: level >= true, 32.0, 0.25)
    assert low < true <= high
    assert high - low <= 0.25
    assert tried == 2 + 7


def test_bisection_has_open_ends():
    assert bracket(lambda level: True, 32.0, 1.0)[0] == (None, 0.0)
    assert bracket(lambda level: False, 32.0, 1.0)[0] == (32.0, None)


SIZES = {
    "wind": lambda s: np.linalg.norm(s.wind[0].velocity),
    "bias": lambda s: np.linalg.norm(s.faults[0].bias_deg),
    "dropout": lambda s: s.faults[0].probability,
    "delay": lambda s: s.faults[0].delay_s,
    "tilt": lambda s: s.start.tilt_deg,
}


@pytest.mark.parametrize("name", BREAKING.sweeps)
def test_level_is_the_size_of_the_disturbance_and_the_only_one(name):
    sweep = BREAKING.sweeps[name]
    scenario = sweep.at(0.5, {})
    assert SIZES[name](scenario) == pytest.approx(0.5)
    assert len(scenario.wind) + len(scenario.faults) == (name != "tilt")
    assert scenario.trajectory == load_scenario(sweep.scenario).trajectory
    assert sweep.at(0.5, {"vehicle": "px4-quad"}).vehicle == "px4-quad"


@pytest.fixture
def brittle(monkeypatch):
    """Cells in which `truth` breaks at 10 m/s of wind, and `mahony` does not run."""
    flown = []

    def fly(name, scenario, estimator, settings):
        flown.append((name, estimator))
        if estimator == "mahony":
            return failed_cell(name, estimator, "no idea")
        cause = "tilted over" if scenario.wind[0].velocity[0] >= 10.0 else ""
        flights = [flight(name, estimator, seed, 1.0, cause) for seed in range(settings.seeds)]
        return Cell(name, estimator, "", flights, [], None)

    monkeypatch.setattr(runner, "fly_cell", fly)
    return flown


def test_points_are_found_stored_and_resumed(tmp_path, brittle, monkeypatch):
    only_wind = BREAKING.model_copy(update={"sweeps": {"wind": BREAKING.sweeps["wind"]}})

    def find(code="a"):
        monkeypatch.setattr(runner, "flight_code", lambda: code)
        names, settings = ["truth", "mahony"], FlightSettings(2)
        return bench(["wind-8"], names, tmp_path, settings, experiment=only_wind, workers=1)

    truth, mahony = find().points
    assert (truth.flies_at, truth.crashes_at, truth.cause) == (9.75, 10.0, "tilted over")
    assert mahony.reason == "no idea"
    assert (truth.text, mahony.text) == ("10", "did not run")
    assert load_results(tmp_path).points == [truth, mahony]
    brittle.clear()
    assert list(find().points) == [truth, mahony]
    assert {estimator for _, estimator in brittle} == {"mahony"}
    find("b")
    assert ("wind=10", "truth") in brittle


def test_a_disturbance_after_the_end_is_no_level_that_is_flown(tmp_path):
    with pytest.raises(ValueError, match="it begins at 6 s, and flights last 3 s"):
        bench(
            ["hover"], ["truth"], tmp_path / "out", FlightSettings(), {"duration_s": 3.0}, experiment=BREAKING
        )
    assert not (tmp_path / "out").exists()


def flight(scenario, estimator, seed, error, cause=""):
    metrics = dict.fromkeys(each.name for each in fields(FlightMetrics))
    metrics |= {"error_deg": error, "attitude_deg": 2 * error}
    return FlightRow(scenario, estimator, seed, cause, 1.0, **metrics)


def test_pairing_removes_what_the_flights_share():
    hard = np.random.default_rng(0).uniform(1, 50, 6)
    gap = np.array([1.0, 1.2, 0.8, 1.1, 0.9, 1.0])
    flown = by_contender(
        [flight("a", "x", i, hard[i] + gap[i]) for i in range(6)]
        + [flight("a", "y", i, hard[i]) for i in range(6)]
    )
    half = 2.5706 * gap.std(ddof=1) / np.sqrt(6)  # Student's t at 97.5 % with 5 degrees of freedom
    found = paired_difference(flown["x"], flown["y"], "error_deg")
    assert found == pytest.approx((1.0, 1 - half, 1 + half), rel=1e-4)


def test_crashed_flights_make_no_pair():
    flights = [flight("a", "x", 0, 9.0, "tilted over"), flight("a", "x", 1, 3.0), flight("b", "x", 1, 5.0)]
    flights += [flight("a", "y", 0, 1.0), flight("a", "y", 1, 1.0), flight("b", "y", 1, 1.0, "flew away")]
    flown = by_contender(flights)
    assert paired_difference(flown["x"], flown["y"], "error_deg") == (2.0, None, None)
    assert paired_difference(flown["x"], flown["y"], "position_m") == (None, None, None)
