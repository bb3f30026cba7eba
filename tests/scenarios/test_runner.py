import json
from importlib.resources import files
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from small_bench import SHORT, small

import estimators
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import Scenario, Start, load_scenario
from quadsim.vehicle import load_vehicle
from scenarios.bench import runner
from scenarios.bench.cell import FlightSettings, fly_cell
from scenarios.bench.flight_log import fly_mission
from scenarios.bench.results import hours, load_results
from scenarios.bench.verdict import verdict
from scenarios.report.terminal import standings_table
from scenarios.single_flight import fly_scenario


def test_log_holds_what_the_loop_did():
    mission = Mission(Scenario(description="", duration_s=0.2), estimators.create("madgwick"), 2)
    log, end, _ = fly_mission(mission, seed=4)
    assert end.tolist() == [40, 40]
    np.testing.assert_array_equal(log["position"][:, -1], mission.plant.position)
    np.testing.assert_array_equal(log["estimate"][:, -1], mission.attitude)
    up = mission.plant.quat
    np.testing.assert_allclose(
        np.cos(log["tilt"][:, -1]), 1 - 2 * (up[:, 1] ** 2 + up[:, 2] ** 2), atol=1e-12
    )


def test_true_attitude_follows_the_command_better_than_a_poor_estimate():
    scenario = Scenario(description="", duration_s=2.0, start=Start(tilt_deg=20.0))
    cells = [fly_cell("x", scenario, name, FlightSettings(4)) for name in ("truth", "complementary")]
    good, poor = (np.mean([flight["attitude_deg"] for flight in cell.flights]) for cell in cells)
    assert good < 0.9 * poor


def test_results_do_not_depend_on_the_workers(tmp_path):
    one = small(tmp_path / "one")
    two = small(tmp_path / "two", workers=2)
    assert one.cells == two.cells
    for name in ("results.csv", "flights.parquet"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@pytest.fixture
def flown(monkeypatch):
    """Scenario and estimator of each cell that is flown, and not read."""
    found = []
    monkeypatch.setattr(runner, "fly_cell", lambda *job: found.append(job[:3:2]) or fly_cell(*job))
    return found


def test_second_run_flies_nothing_says_the_same_and_is_read_back(tmp_path, flown):
    first = small(tmp_path)
    assert len(flown) == 4
    cpu_s = sum(cell.cpu_s for cell in first.cells)
    assert first.cost == f"8 flights, 2 s in the air; {hours(cpu_s)} of processor time"
    again = small(tmp_path)
    assert len(flown) == 4
    assert (again, again.cost) == (first, first.cost)
    assert load_results(tmp_path) == first
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "flights.parquet"), first.flights)


def test_interrupted_run_goes_on_with_what_is_missing(tmp_path, monkeypatch, flown):
    whole = small(tmp_path / "whole")
    flown.clear()
    counting = runner.fly_cell

    def until_the_third(*job):
        if len(flown) == 2:
            raise KeyboardInterrupt
        return counting(*job)

    monkeypatch.setattr(runner, "fly_cell", until_the_third)
    with pytest.raises(KeyboardInterrupt):
        small(tmp_path / "part")
    next((tmp_path / "part" / "cells").iterdir()).write_text("half a fi")  # and one file is damaged
    monkeypatch.setattr(runner, "fly_cell", counting)
    flown.clear()
    assert small(tmp_path / "part") == whole
    assert flown[-2:] == [("wind-gust", "truth"), ("wind-gust", "mahony")]
    assert len(flown) == 3


def test_cells_of_another_configuration_or_code_are_flown_anew(tmp_path, monkeypatch, flown):
    small(tmp_path)
    changes = {"seed": 1}, {"seeds": 3}, {"duration_s": 0.2}, {"external": "ideal"}
    for count, change in enumerate(changes, 2):
        small(tmp_path, **change)
        assert len(flown) == 4 * count
    monkeypatch.setattr(runner, "flight_code", lambda: "other code")
    small(tmp_path, **change)
    assert len(flown) == 24


def test_weights_fly_like_the_estimator_that_they_are_of(tmp_path):
    ours = tmp_path / "mine.safetensors"
    ours.write_bytes((files("assets") / "weights" / "att-snn.safetensors").read_bytes())
    shipped, mine = small(tmp_path, scenarios=["hover"], names=["att-snn", str(ours)]).rows
    assert mine.estimator == str(ours)
    assert mine._replace(estimator="att-snn") == shipped
    assert runner.files_of(Scenario(description=""), f"{ours} @ {ours}") == [str(ours)] * 2


def test_crashes_are_counted_and_the_standings_fit_a_console(tmp_path):
    crashing = tmp_path / "crashing.toml"
    crashing.write_text("description = ''\n[start]\ntilt_deg = 40.0\n[crash]\ntilt_deg = 30.0\n")
    many = small(tmp_path / "many", scenarios=["hover", "wind-2", crashing])
    crashed = many.flights[many.flights["scenario"] == "crashing"]
    assert {*zip(crashed["cause"], crashed["flown_s"], strict=True)} == {("tilted over", 0.0)}
    row = many.rows[-1]
    assert (row.crashes, row.crash_rate) == (2, 1.0)
    assert 0.3 < row.crash_low < row.crash_high == 1.0
    table = standings_table(verdict(many))
    console = Console(width=80, file=StringIO())
    console.print(table)
    assert "…" not in console.file.getvalue()
    assert "flights.parquet" in console.file.getvalue()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"names": []}, "at least one estimator"),
        ({"scenarios": []}, "at least one scenario"),
        ({"seeds": 0}, "seeds is 0"),
    ],
)
def test_bad_arguments_are_named(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        small(tmp_path, **change)


def test_two_scenarios_of_one_name_are_refused(tmp_path):
    (tmp_path / "hover.toml").write_text('description = "another"')
    with pytest.raises(ValueError, match='two scenarios are called "hover"'):
        small(tmp_path / "out", scenarios=["hover", tmp_path / "hover.toml"])


def test_folder_without_results_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"no bench\.json"):
        load_results(tmp_path)
    (tmp_path / "bench.json").write_text(json.dumps({"settings": 3}))
    with pytest.raises(ValueError, match="not the results of a benchmark"):
        load_results(tmp_path)


def test_any_flight_of_a_benchmark_can_be_looked_at(tmp_path):
    benchmark = small(tmp_path / "bench", names=["mahony"], scenarios=["hover"], seeds=3)
    alone = fly_scenario("hover", "mahony", tmp_path, changes={"duration_s": SHORT}, flight=2)
    assert alone.results.cells[0].flights[0] | {"seed": 2} == benchmark.cells[0].flights[2]
    rows = pd.read_csv(alone.samples)
    assert rows["t"].to_numpy() == pytest.approx(np.arange(60) / 200)
    assert rows["z"].iloc[-1] == pytest.approx(2.0, abs=0.02)
    assert "mahony" in alone.report.read_text()
    assert alone.video is None


def test_another_vehicle_is_flown_with_its_own_tuning_and_a_mismatch_is_warned_of(tmp_path):
    def flown(**changes):
        return small(tmp_path / "-".join(changes.values()), scenarios=["hover"], names=["vqf"], **changes)

    assert flown().warnings == []
    assert flown(vehicle="px4-quad", imu="px4-mini").warnings == []
    (line,) = flown(vehicle="crazyflie").warnings
    assert "for the hummingbird, not for the simulated crazyflie with adis16448: vqf" in line
    (line,) = flown(vehicle="px4-quad", imu="px4-mini", tuning="hummingbird-adis16448").warnings
    assert "quadsim tune" in line
    ours, given = flown(vehicle="px4-quad").rows[0], flown(vehicle="px4-quad", tuning="px4-quad-px4-mini")
    assert ours.error_deg == given.rows[0].error_deg
    with pytest.raises(ValueError, match="has no table of truth"):
        small(tmp_path, names=["truth"], tuning="px4-quad-px4-mini")


def test_paths_in_a_scenario_count_from_its_file(tmp_path, monkeypatch):
    (tmp_path / "airframes").mkdir()
    own = (files("assets") / "vehicles" / "px4-quad.toml").read_text()
    (tmp_path / "airframes" / "mine.toml").write_text(own)
    (tmp_path / "own.toml").write_text("description = 'own'\nvehicle = 'airframes/mine.toml'\n")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    found = load_scenario("../own.toml")
    assert load_vehicle(found.vehicle).name == load_vehicle("px4-quad").name
    (row,) = small(tmp_path / "out", scenarios=["../own.toml"], names=["truth"]).rows
    assert row.reason == ""


def test_a_changed_file_that_the_users_code_imports_is_flown_anew(tmp_path, monkeypatch, flown):
    monkeypatch.chdir(tmp_path)
    Path("helper.py").write_text("SIZE = 0.0")
    Path("est.py").write_text(
        "import numpy as np\nfrom helper import SIZE\nclass Mine:\n    def __init__(self, rate_hz): pass\n"
        "    def reset(self, n=1, roll_pitch=None): self.n = n\n"
        "    def update(self, gyro, accel): return np.full((self.n, 2), SIZE)\n"
    )
    (tmp_path / "hover.py").write_text(
        "import numpy as np\nfrom helper import SIZE\n"
        "def at(t): return np.column_stack([0 * t, 0 * t, 1 + SIZE + 0 * t])\n"
    )
    Path("mine.toml").write_text(
        'description = "mine"\nduration_s = 0.3\n[trajectory]\nkind = "function"\nfunction = "hover.py:at"\n'
    )
    Path("control.py").write_text("import helper\ndef make(rate_hz, vehicle): return None\n")

    def cells():
        done = small(tmp_path / "out", scenarios=["hover", "mine.toml"], names=["truth", "est.py:Mine"])
        return {(cell.scenario, cell.estimator): cell for cell in done.cells}

    before = cells()
    assert {cell.reason for cell in before.values()} == {""}
    Path("helper.py").write_text("SIZE = 0.2")
    flown.clear()
    after = cells()
    assert before.keys() - flown == {("hover", "truth")}
    mine = "hover", "est.py:Mine"
    assert after[mine].flights[0]["error_deg"] > 5 + before[mine].flights[0]["error_deg"]
    read = runner.files_of(load_scenario("hover"), "truth @ control.py:make")
    assert [Path(path).name for path in read] == ["control.py", "helper.py"]
