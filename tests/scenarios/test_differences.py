"""Breaking points, and paired differences."""

import numpy as np
import pytest
from flown import benchmark, crash, table

from quadsim.flight.scenario import load_scenario
from scenarios.bench.experiment import load_experiment
from scenarios.bench.ranking import paired_difference
from scenarios.report.terminal import breaking_table

BREAKING = load_experiment("breaking-points")
SIZES = {
    "constant wind": lambda s: np.linalg.norm(s.wind[0].velocity),
    "step of the gyro bias": lambda s: np.linalg.norm(s.faults[0].bias_deg),
    "lost samples": lambda s: s.faults[0].probability,
    "late samples": lambda s: s.faults[0].delay_s,
    "unknown initial tilt": lambda s: s.start.tilt_deg,
}


@pytest.mark.parametrize("name", BREAKING.sweeps)
def test_level_is_the_size_of_the_disturbance_and_the_only_one(name):
    sweep = BREAKING.sweeps[name]
    scenario = sweep.at(0.5)
    assert SIZES[name](scenario) == pytest.approx(0.5)
    assert len(scenario.wind) + len(scenario.faults) == (name != "unknown initial tilt")
    assert scenario.trajectory == load_scenario(sweep.scenario).trajectory
    assert list(sweep.levels) == sorted(sweep.levels)


def test_a_breaking_point_is_the_least_level_with_a_crash():
    two = {name: BREAKING.sweeps[name] for name in ("constant wind", "late samples")}
    both = BREAKING.model_copy(update={"sweeps": two})
    cases, winds = both.cases(), len(two["constant wind"].levels)
    levels = {name: case.levels for name, case in cases.items()}
    assert levels["constant wind=8"] == {"constant wind": "8 m/s"}
    late = [[1.0, 1.0]] * (len(cases) - winds)
    outcomes = {
        "strong": [[1.0, 1.0]] * winds + late,
        "brittle": [[1.0, crash(5.0) if k == 2 or k > 3 else 1.0] for k in range(winds)] + late,
        "absent": ["no idea"] * winds + late,
    }
    flown = {name: dict(zip(cases, own, strict=True)) for name, own in outcomes.items()}
    results = benchmark(flown, experiment=both, levels=levels)
    found = [results.breaking_point("constant wind", name) for name in outcomes]
    assert found == ["> 36 m/s", "12 m/s", "did not run"]
    assert {results.breaking_point("late samples", name) for name in outcomes} == {"> 0.2 s"}
    assert breaking_table(results).row_count == 3


def test_pairing_removes_what_the_flights_share():
    hard = np.random.default_rng(0).uniform(1, 50, 6)
    gap = np.array([1.0, 1.2, 0.8, 1.1, 0.9, 1.0])
    flights = [("a", name, i, hard[i] + k * gap[i]) for k, name in enumerate("yx") for i in range(6)]
    half = 2.5706 * gap.std(ddof=1) / np.sqrt(6)  # Student's t at 97.5 % with 5 degrees of freedom
    assert paired_difference(table(*flights), "x", "y", "error_deg") == pytest.approx((1.0, half), rel=1e-4)


def test_crashed_flights_make_no_pair():
    flights = [("a", "x", 0, crash(1.0, 9.0)), ("a", "x", 1, 3.0), ("b", "x", 1, 5.0)]
    flights += [("a", "y", 0, 1.0), ("a", "y", 1, 1.0), ("b", "y", 1, crash(1.0, 1.0))]
    found = [paired_difference(table(*flights), "x", "y", key) for key in ("error_deg", "position_m")]
    np.testing.assert_array_equal(found, [(2.0, np.nan), (np.nan, np.nan)])
