"""Experiments: designed combinations of levels, and what of a scenario they set."""

import re
from collections import Counter
from itertools import combinations

import pandas as pd
import pytest

from quadsim.config.toml import preset_names
from quadsim.flight.scenario import load_scenario, scenario_names
from scenarios.bench.cell import FlightSettings
from scenarios.bench.experiment import FOLDER, Sweep, load_experiment, with_levels
from scenarios.bench.results import load_results
from scenarios.bench.runner import bench

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
    levels = {"initial attitude": "given, 4° wrong", "motion": "4 m/s", "drag": "twice what is known"}
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
    results = bench(
        ["hover"], ["truth", "ekf-drag"], tmp_path, FlightSettings(), {"duration_s": 0.3},
        experiment=few, workers=1,
    )  # fmt: skip
    unknown = {name for name, levels in results.levels.items() if levels["drag"] == "not known"}
    failed = {(cell.scenario, cell.estimator) for cell in results.cells if cell.reason}
    assert failed == {(name, "ekf-drag") for name in unknown}
    assert results.by_level["drag", "not known", "ekf-drag"].reason.startswith("ekf-drag needs a vehicle")
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
