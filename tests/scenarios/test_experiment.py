"""Experiments: combinations of levels and what they set, breaking points, and paired differences."""

import re
from collections import Counter
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from flown import benchmark, crash, table

from quadsim.config.toml import preset_names
from quadsim.flight.scenario import load_scenario, scenario_names
from scenarios.bench.cell import FlightSettings
from scenarios.bench.experiment import FOLDER, Sweep, load_experiment, with_levels
from scenarios.bench.ranking import paired_difference
from scenarios.bench.results import load_results
from scenarios.bench.runner import bench
from scenarios.report.terminal import breaking_table

AXES = load_experiment("axes")


def test_every_experiment_that_ships_can_be_flown():
    for name in preset_names(FOLDER):
        assert load_experiment(name).cases()
    assert list(load_experiment("suite").cases()) == scenario_names()


def test_every_level_is_flown_equally_often_and_beside_every_other():
    cases = AXES.cases()
    assert len(cases) == 72
    axes = {axis: [case.levels[axis] for case in cases.values()] for axis in (*AXES.axes, "scenario")}
    for levels in axes.values():
        assert len(set(Counter(levels).values())) == 1
    for first, second in combinations(axes, 2):
        together = Counter(zip(axes[first], axes[second], strict=True))
        assert len(together) == len(set(axes[first])) * len(set(axes[second]))
    assert cases == AXES.cases()
    with pytest.raises(ValueError, match="combinations = 3: an axis has 4 levels"):
        AXES.model_copy(update={"combinations": 3}).cases()


def test_a_combination_is_its_scenario_with_what_the_levels_set():
    levels = {"initial attitude": "given, 4° wrong", "motion": "4 m/s", "drag": "twice the known value"}
    levels |= {"airframe": "crazyflie", "IMU": "rough, vibration, lever arm"}
    base = load_scenario("saturation")
    found = with_levels(base, levels, AXES.axes)
    assert (found.vehicle, found.imu, found.drag_factor) == ("crazyflie", "rough", 2.0)
    assert (found.start.attitude_error_deg, found.start.speed) == (4.0, 4.0)
    assert [fault.kind for fault in found.faults] == ["saturation", "vibration", "lever-arm"]
    assert found.trajectory == base.trajectory
    assert "crazyflie" in found.description


def test_a_designed_benchmark_flies_loads_and_has_its_levels_in_the_table(tmp_path):
    few = AXES.model_copy(update={"combinations": 4})
    names, short = ["truth", "ekf-drag"], {"duration_s": 0.3}
    results = bench(["hover"], names, tmp_path, FlightSettings(), short, experiment=few, workers=1)
    unknown = {name for name, levels in results.levels.items() if levels["drag"] == "not known"}
    failed = {(cell.scenario, cell.estimator) for cell in results.cells if cell.reason}
    assert failed == {(name, "ekf-drag") for name in unknown}
    assert results.by_level["drag", "not known", "ekf-drag"].reason.startswith("ekf-drag needs the drag")
    assert not any(row.reason for row in results.by_level.values() if row.flights)
    assert load_results(tmp_path) == results
    table = pd.read_parquet(tmp_path / "flights.parquet")
    assert set(table["base scenario"]) == {"hover"}
    assert set(table["drag"]) == set(AXES.axes["drag"])
    with pytest.raises(ValueError, match="vehicle: the experiment varies it"):
        bench(["hover"], ["truth"], tmp_path, FlightSettings(), {"vehicle": "crazyflie"}, experiment=few)


CONDITION = """
description = "x"
combinations = 2
[axes.wind."2 m/s"]
[axes.wind."4 m/s"]
[[conditions]]
name = "In calm air"
clause = "in calm air"
axis = "{axis}"
levels = ["{level}"]
"""


@pytest.mark.parametrize(
    ("axis", "level", "message"),
    [
        ("air", "2 m/s", 'own.toml: condition "In calm air": the axis "air" has no level "2 m/s"'),
        ("wind", "3 m/s", 'the axis "wind" has no level "3 m/s"; did you mean "4 m/s"? valid: 2 m/s, 4 m/s'),
    ],
)
def test_a_condition_on_a_level_that_is_not_flown_is_refused_before_the_flights(
    tmp_path, axis, level, message
):
    path = tmp_path / "own.toml"
    path.write_text(CONDITION.format(axis=axis, level=level))
    with pytest.raises(ValueError, match=re.escape(message)):
        load_experiment(path)


@pytest.mark.parametrize("scaled", ["nope", "wind.1.velocity", "wind.0.speed", "wind.0.kind.x"])
def test_a_sweep_over_what_is_no_number_of_its_fields_is_refused(scaled):
    wind = {"kind": "constant", "velocity": [1.0, 0.0, 0.0]}
    sweep = Sweep(scenario="hover", fields={"wind": [wind]}, scaled=scaled, levels=(1.0,))
    with pytest.raises(ValueError, match=f'scaled = "{scaled}": names no number or vector of fields'):
        sweep.at(1.0)


BREAKING = load_experiment("breaking-points")
SIZES = {
    "constant wind": lambda s: np.linalg.norm(s.wind[0].velocity),
    "step of the gyro bias": lambda s: np.linalg.norm(s.faults[0].gyro_deg),
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
