"""Breaking points and paired differences."""

from dataclasses import fields

import numpy as np
import pytest

from quadsim.flight.scenario import load_scenario
from scenarios.bench import breaking
from scenarios.bench.breaking import DISTURBANCES, bisect, breaking_points, load_points
from scenarios.bench.cell import Cell, failed_cell
from scenarios.bench.flight_metrics import FlightMetrics, FlightRow
from scenarios.bench.pairs import paired_differences
from scenarios.bench.settings import FlightSettings, ScenarioChanges


@pytest.mark.parametrize("true", [0.3, 7.77, 31.9])
def test_bisection_brackets_the_first_level_that_crashes(true):
    tried = []
    low, high = bisect(lambda level: tried.append(level) or level >= true, 32.0, 0.25)
    assert low < true <= high
    assert high - low <= 0.25
    assert len(tried) == 2 + 7


def test_bisection_has_open_ends():
    assert bisect(lambda level: True, 32.0, 1.0) == (None, 0.0)
    assert bisect(lambda level: False, 32.0, 1.0) == (32.0, None)


@pytest.mark.parametrize("name", DISTURBANCES)
def test_level_is_the_size_of_the_disturbance(name):
    kind = DISTURBANCES[name]
    scenario = kind.change(load_scenario(kind.scenario), 0.5)
    size = {
        "wind": lambda: np.linalg.norm(scenario.wind[0].velocity),
        "bias": lambda: np.linalg.norm(scenario.faults[0].bias_deg),
        "dropout": lambda: scenario.faults[0].probability,
    }
    assert size[name]() == pytest.approx(0.5)
    assert len(scenario.wind) + len(scenario.faults) == 1


@pytest.fixture
def brittle(monkeypatch):
    """Cells in which `truth` breaks at 10 m/s of wind, and `mahony` does not run."""
    flown = []

    def fly(name, scenario, estimator, settings):
        flown.append((estimator, scenario.wind[0].velocity[0]))
        if estimator == "mahony":
            return failed_cell(name, estimator, "", "no idea")
        cause = "tilted over" if scenario.wind[0].velocity[0] >= 10.0 else ""
        flights = [flight(name, estimator, seed, 1.0, cause) for seed in range(settings.seeds)]
        return Cell(name, estimator, "", "", flights, [], None)

    monkeypatch.setattr(breaking, "fly_cell", fly)
    return flown


def test_points_are_found_stored_and_loaded(tmp_path, brittle, monkeypatch):
    def find(code="a"):
        monkeypatch.setattr(breaking, "suite_digest", lambda: code)
        return breaking_points(["wind"], ["truth", "mahony"], tmp_path, FlightSettings(2), workers=1)

    truth, mahony = find()
    assert (truth.flies_at, truth.crashes_at, truth.cause) == (9.75, 10.0, "tilted over")
    assert mahony.reason == "no idea"
    assert (truth.text, mahony.text) == ("10", "did not run")
    assert load_points(tmp_path) == [truth]
    flown = len(brittle)
    assert find() == [truth, mahony]
    assert {estimator for estimator, _ in brittle[flown:]} == {"mahony"}
    flown = len(brittle)
    find("b")
    assert "truth" in {estimator for estimator, _ in brittle[flown:]}


def test_unknown_disturbance_is_named(tmp_path):
    with pytest.raises(ValueError, match='unknown breaking point "rain"; valid: wind, bias, dropout, all'):
        breaking_points(["rain"], ["truth"], tmp_path, FlightSettings())


def test_a_disturbance_after_the_end_is_no_level_that_is_flown(tmp_path):
    with pytest.raises(ValueError, match="bias: it begins at 6 s, and flights last 3 s"):
        breaking_points(["bias"], ["truth"], tmp_path, FlightSettings(), ScenarioChanges(3.0))


def flight(scenario, estimator, seed, error, cause=""):
    metrics = dict.fromkeys(each.name for each in fields(FlightMetrics))
    metrics |= {"error_deg": error, "attitude_deg": 2 * error}
    return FlightRow(scenario, estimator, seed, cause, 1.0, **metrics)


def test_pairing_removes_what_the_flights_share():
    hard = np.random.default_rng(0).uniform(1, 50, 6)
    gap = np.array([1.0, 1.2, 0.8, 1.1, 0.9, 1.0])
    flights = [flight("a", "x", i, hard[i] + gap[i]) for i in range(6)]
    flights += [flight("a", "y", i, hard[i]) for i in range(6)]
    row = next(r for r in paired_differences(flights) if (r.scenario, r.metric) == ("a", "error_deg"))
    assert (row.estimator, row.versus, row.pairs) == ("x", "y", 6)
    assert row.difference == pytest.approx(1.0)
    half = 2.5706 * gap.std(ddof=1) / np.sqrt(6)  # Student's t at 97.5 % with 5 degrees of freedom
    assert (row.low, row.high) == pytest.approx((1 - half, 1 + half), rel=1e-4)


def test_crashed_flights_make_no_pair_but_are_counted():
    flights = [flight("a", "x", 0, 9.0, "tilted over"), flight("a", "x", 1, 3.0), flight("b", "x", 1, 5.0)]
    flights += [flight("a", "y", 0, 1.0), flight("a", "y", 1, 1.0), flight("b", "y", 1, 1.0, "flew away")]
    rows = {(r.scenario, r.metric): r for r in paired_differences(flights)}
    assert (rows["a", "error_deg"].pairs, rows["a", "error_deg"].difference) == (1, 2.0)
    assert (rows["b", "error_deg"].pairs, rows["b", "error_deg"].difference) == (0, None)
    assert rows["all", "error_deg"].difference == 2.0
    assert (rows["all", "error_deg"].crashed_alone, rows["all", "error_deg"].versus_crashed_alone) == (
        1,
        1,
    )
    assert rows["all", "position_m"].pairs == 0
