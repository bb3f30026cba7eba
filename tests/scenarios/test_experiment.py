"""Experiments: designed combinations of levels, and what of a scenario they set."""

from collections import Counter
from itertools import combinations

import pandas as pd
import pytest

from quadsim.config.toml import preset_names
from quadsim.flight.scenario import load_scenario, scenario_names
from scenarios.bench.cell import FlightSettings
from scenarios.bench.experiment import FOLDER, load_experiment, with_levels
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
