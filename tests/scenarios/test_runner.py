import csv
import json
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from importlib.resources import files
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from flown import crash, table
from processes import square
from rich.console import Console

import estimators
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import Scenario, Start, load_scenario
from quadsim.runs.pool import run_all
from quadsim.vehicle import load_vehicle
from scenarios.bench import cell as cell_module
from scenarios.bench import runner
from scenarios.bench.cell import FlightSettings, fly_cell
from scenarios.bench.flight_log import fly, log_dtype
from scenarios.bench.flight_metrics import (
    convergence_time,
    error_histogram,
    flight_metrics,
    recovery_time,
)
from scenarios.bench.results import hours, load_results, summarise, wilson
from scenarios.bench.runner import bench
from scenarios.bench.verdict import choice, verdict
from scenarios.report.terminal import standings_table
from scenarios.single_flight import fly_scenario

SHORT = 0.3
HUMMINGBIRD = load_vehicle("hummingbird")


def small(out, scenarios=("hover", "wind-gust"), names=("truth", "mahony"), **options):
    """A benchmark; options are of `bench`, of its settings, or fields of every scenario."""
    run = {"workers": 1} | {key: options.pop(key) for key in ("workers", "executor") if key in options}
    of_flights = {key: options.pop(key) for key in ("seeds", "seed", "tuning") if key in options}
    return bench(
        scenarios,
        names,
        out,
        FlightSettings(**{"seeds": 2} | of_flights),
        {"duration_s": SHORT} | options,
        **run,
    )


# --- metrics --------------------------------------------------------------------------------------


def steady_log(n=2, steps=400):
    """A log of level flight on the set-point with a perfect estimate."""
    log = np.zeros((n, steps), log_dtype(4))
    log["rotor_vel"] = HUMMINGBIRD.hover_rotor_vel
    return log, np.full(n, steps)


def metrics_of(log, end):
    return flight_metrics(log, end, 200.0, HUMMINGBIRD)


def test_a_perfect_hover_has_no_error_and_the_power_that_carries_the_weight():
    metrics = metrics_of(*steady_log())
    power = HUMMINGBIRD.mass * 9.81 * HUMMINGBIRD.motor.k_m * HUMMINGBIRD.hover_rotor_vel
    np.testing.assert_allclose(metrics.pop("power_w"), power)
    np.testing.assert_array_equal(list(metrics.values()), 0.0)


def test_every_metric_is_of_its_own_signal():
    log, end = steady_log()
    log["tracking"][:, ::2] = np.radians(10.0)
    log["tilt"][:, 7] = np.radians(40.0)
    log["command_change"] = np.resize([3.0, 4.0], 400)
    log["estimate"][:, ::2] = np.radians([3.0, 0.0])
    log["position"] = [0.3, 0.0, 0.4]
    wanted = {
        "attitude_deg": 10.0 / np.sqrt(2.0),
        "worst_tilt_deg": 40.0,
        "jitter": np.sqrt((3.0**2 + 4.0**2) / 2.0),
        "inclination_deg": 3.0 / np.sqrt(2.0),
        "error_deg": 0.75,
        "position_m": 0.5,
    }
    metrics = metrics_of(log, end)
    np.testing.assert_allclose([metrics[key][0] for key in wanted], list(wanted.values()))


def test_errors_are_counted_in_twenty_parts_of_each_decade_from_a_thousandth_of_a_degree():
    log, end = steady_log(1, 10)
    log["estimate"][0, :4] = np.radians([3.0, -1.2])
    counts = error_histogram(log, end)
    found = {int(part): int(counts[part]) for part in np.flatnonzero(counts)}
    assert found == {0: 12, int(20 * np.log10(1.2e3)): 4, int(20 * np.log10(3e3)): 4}


def test_nothing_after_a_crash_counts():
    log, end = steady_log()
    log[0, 100:] = np.nan
    end[0] = 100
    np.testing.assert_array_equal(metrics_of(log, end)["error_deg"], 0.0)
    assert error_histogram(log, end).sum() == 2 * (100 + 400)


def test_time_to_converge_is_the_start_of_the_first_second_below_the_limit():
    error = np.full((3, 1000), 20.0)
    error[0, 300:] = 1.0
    error[1, 100:250] = 1.0  # three quarters of a second are not enough
    error[1, 600:] = 1.0
    np.testing.assert_array_equal(convergence_time(error, 200.0), [1.5, 3.0, np.nan])


def test_recovery_is_the_longest_spell_away_that_ended():
    apart = np.zeros((5, 1000))
    apart[0, 100:150] = apart[0, 300:500] = 2.0
    apart[1, 700:] = 2.0  # still away at the end
    apart[2, 10:30] = 2.0  # back, but crashed later
    apart[4, 100:120] = apart[4, 990:] = 2.0  # thrown off again at the very end
    whole = np.array([True, True, False, True, True])
    np.testing.assert_array_equal(recovery_time(apart, whole, 200.0), [1.0, np.nan, np.nan, 0.0, 0.1])


def test_wilson_interval_of_textbook_values():
    found = wilson(pd.Series([0, 5, 10, 0]), pd.Series([10, 10, 10, 0]))  # Brown, Cai, DasGupta 2001
    np.testing.assert_allclose(found, [[0.0, 0.2366, 0.7225, 0.0], [0.2775, 0.7634, 1.0, 1.0]], atol=1e-4)


def test_median_convergence_is_empty_when_most_never_converge_and_a_crash_counts_to_the_tilt():
    flights = table(*((name, "x", k, crash(1.0) if k == 2 else 0.5) for name in "ab" for k in range(3)))
    flights["converge_s"] = [1.0, 1.0, np.nan, 1.0, np.nan, np.nan]
    flights["worst_tilt_deg"] = [10.0, 20.0, 80.0, 30.0, np.nan, np.nan]
    found = summarise(flights)
    np.testing.assert_array_equal(found["converge_s"], [1.0, np.nan])
    np.testing.assert_array_equal(found["worst_tilt_deg"], [80.0, 30.0])


# --- a flight -------------------------------------------------------------------------------------


def test_log_holds_what_the_loop_did():
    mission = Mission(Scenario(description="", duration_s=0.2), estimators.create("madgwick"), 2)
    log, end, _ = fly(mission, seed=4)
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


# --- the benchmark --------------------------------------------------------------------------------


def test_results_do_not_depend_on_the_workers(tmp_path):
    one = small(tmp_path / "one")
    two = small(tmp_path / "two", workers=2)
    assert one.cells == two.cells
    for name in ("results.csv", "flights.parquet"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_flights_do_not_depend_on_how_many_there_are(tmp_path):
    few, many = small(tmp_path / "few", seeds=1), small(tmp_path / "many", seeds=3)
    first = many.flights[many.flights["seed"] == 0].reset_index(drop=True)
    pd.testing.assert_frame_equal(first, few.flights)


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


def test_a_dying_worker_ends_no_other_job():
    found = dict(run_all(square, {i: (i, 1) for i in range(4)}, workers=2))
    assert isinstance(found.pop(1), BrokenExecutor)
    assert found == {0: 0, 2: 4, 3: 9}


def test_numbers_beyond_all_bounds_are_a_row_with_its_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(cell_module, "BOUNDLESS", 1.0)
    (hover,) = small(tmp_path, scenarios=["hover"], names=["mahony"]).rows
    assert "the flight diverged" in hover.reason


@pytest.mark.parametrize("error", [ZeroDivisionError("no idea"), SystemExit("no idea")])
def test_cell_that_fails_is_a_row_with_its_reason(tmp_path, monkeypatch, error):
    def broken(mission, seed):
        raise error

    monkeypatch.setattr(cell_module, "fly", broken)
    results = small(tmp_path)
    reasons = [row.reason for row in results.rows]
    assert reasons == [f"{type(error).__name__}: no idea"] * 4
    assert load_results(tmp_path) == results
    with (tmp_path / "results.csv").open() as file:
        assert [row["reason"] for row in csv.DictReader(file)] == reasons
    monkeypatch.undo()
    assert not any(row.reason for row in small(tmp_path).rows)  # and it is tried again


def test_dead_worker_is_a_row_with_its_reason(tmp_path):
    class Deadly(ThreadPoolExecutor):
        def submit(self, fn, *args):
            if args[2] == "truth":
                future = Future()
                future.set_exception(MemoryError("killed"))
                return future
            return super().submit(fn, *args)

    with Deadly(1) as executor:
        rows = small(tmp_path, executor=executor).rows
    assert [row.reason for row in rows] == ["MemoryError: killed", ""] * 2


def test_the_standings_have_ranks_means_and_the_worst_scenario(tmp_path):
    crashing = tmp_path / "crashing.toml"
    crashing.write_text("description = ''\n[start]\ntilt_deg = 40.0\n[crash]\ntilt_deg = 30.0\n")
    many = small(tmp_path / "many", scenarios=["hover", "wind-2", crashing])
    crashed = many.flights[many.flights["scenario"] == "crashing"]
    assert {*zip(crashed["cause"], crashed["flown_s"], strict=True)} == {("tilted over", 0.0)}
    row = many.rows[-1]
    assert (row.crashes, row.crash_rate) == (2, 1.0)
    assert 0.3 < row.crash_low < row.crash_high == 1.0
    table = standings_table(verdict(many))
    cells = {str(column.header): [str(cell) for cell in column.cells] for column in table.columns}
    mahony = [row for row in many.rows if row.estimator == "mahony" and row.error_deg is not None]
    assert cells["estimator"] == ["mahony", "truth"]
    assert cells["rank"] == ["1", "–"]
    assert cells["crashed"] == ["2 of 6 (10–70 %)"] * 2
    assert cells["error [°]"][0] == f"{np.mean([row.error_deg for row in mahony]):.2f}"
    assert cells["tracking [°]"][0] == f"{np.mean([row.attitude_deg for row in mahony]):.2f}"
    assert cells["at worst"] == ["crashing, 2 of 2 crashed, not measured"] * 2
    console = Console(width=80, file=StringIO())
    console.print(table)
    assert "…" not in console.file.getvalue()
    assert "flights.parquet" in console.file.getvalue()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenarios": ["hoover"]}, 'unknown scenario "hoover"; did you mean "hover"'),
        ({"names": ["mahoney"]}, 'unknown estimator "mahoney"; did you mean "mahony"'),
        ({"names": []}, "at least one estimator"),
        ({"scenarios": []}, "at least one scenario"),
        ({"seeds": 0}, "seeds is 0"),
        ({"external": "vicon"}, 'unknown external "vicon"'),
        ({"duration_s": -1.0}, "duration_s = -1.0: should be 0.001 to 3600 s"),
        ({"vehicle": "px5-quad"}, 'unknown vehicle "px5-quad"; did you mean "px4-quad"'),
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
    with alone.samples.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 60
    assert float(rows[-1]["t"]) == pytest.approx(59 / 200)
    assert float(rows[-1]["z"]) == pytest.approx(2.0, abs=0.02)
    assert "mahony" in alone.report.read_text()
    assert alone.video is None


def test_another_vehicle_is_flown_with_its_own_tuning_and_a_mismatch_is_warned_of(tmp_path):
    def flown(**changes):
        return small(tmp_path / "-".join(changes.values()), scenarios=["hover"], names=["vqf"], **changes)

    assert flown().warnings == []
    assert flown(vehicle="px4-quad", imu="px4-mini").warnings == []
    (line,) = flown(vehicle="crazyflie").warnings
    assert "for the hummingbird, not for crazyflie with adis16448, which was simulated: vqf" in line
    (line,) = flown(vehicle="px4-quad", imu="px4-mini", tuning="hummingbird-adis16448").warnings
    assert "quadsim tune" in line
    ours, given = flown(vehicle="px4-quad").rows[0], flown(vehicle="px4-quad", tuning="px4-quad-px4-mini")
    assert ours.error_deg == given.rows[0].error_deg
    with pytest.raises(ValueError, match="has no table of truth"):
        small(tmp_path, names=["truth"], tuning="px4-quad-px4-mini")


def test_paths_in_a_scenario_count_from_its_file(tmp_path, monkeypatch):
    (tmp_path / "airframes").mkdir()
    (tmp_path / "airframes" / "mine.toml").write_text(
        (files("assets") / "vehicles" / "px4-quad.toml").read_text()
    )
    (tmp_path / "wind.csv").write_text("t,x,y,z\n0,1,0,0\n9,1,0,0\n")
    (tmp_path / "own.toml").write_text(
        "description = 'own'\nvehicle = 'airframes/mine.toml'\n[[wind]]\nkind = 'file'\npath = 'wind.csv'\n"
    )
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
    Path("blown.toml").write_text("description = ''\n[[wind]]\nkind = 'file'\npath = 'wind.csv'\n")
    read = runner.files_of(load_scenario("blown.toml"), "truth @ control.py:make")
    assert [Path(path).name for path in read] == ["control.py", "helper.py", "wind.csv"]


HOSTILE = '''
import numpy as np

class Never:
    """The parent of estimators that must not win."""
    def __init__(self, rate_hz):
        self.rate_hz, self.calls = rate_hz, 0
    def reset(self, n=1, roll_pitch=None):
        self.n, self.calls = n, 0
    def restart(self, ids, roll_pitch=None):
        pass
    def update(self, gyro, accel):
        self.calls += 1
        return np.full((self.n, 2), self.value if self.calls > 5 else 0.0)

class NaN(Never): value = np.nan
class Huge(Never): value = 1e20
class Constant(Never): value = 0.0
class Tilted(Never): value = 0.9
class Peek(Never):
    def reset(self, n=1, roll_pitch=None):
        self.truth = np.zeros((n, 2))
    def observe(self, quat):
        w, x, y, z = quat.T
        self.truth = np.stack([2 * (w * x + y * z), 2 * (w * y - x * z)], -1)
    def update(self, gyro, accel):
        return self.truth
class Raises(Never):
    def update(self, gyro, accel):
        if self.calls > 5:
            raise RuntimeError("no idea")
        return super().update(gyro, accel)
    value = 0.0
'''


def test_no_hostile_estimator_wins_a_flown_benchmark(tmp_path):
    (tmp_path / "est.py").write_text(HOSTILE)
    own = {
        name: f"{tmp_path / 'est.py'}:{name}"
        for name in ("NaN", "Huge", "Constant", "Tilted", "Peek", "Raises")
    }
    results = small(tmp_path / "out", scenarios=["hover"], names=["mahony", *own.values()], duration_s=3.0)
    reasons = {name: results.rows[1 + k].reason for k, name in enumerate(own)}
    assert "not a finite number" in reasons["NaN"]
    assert "angles beyond ±100 rad" in reasons["Huge"]
    assert reasons["Raises"] == "Raises: update ends with RuntimeError: no idea"
    assert results.unranked == {
        own["Peek"]: "received the true attitude",
        own["Constant"]: "returned the same roll and pitch at every sample",
    }
    assert verdict(results).headline.startswith("In hover fly mahony")
    assert {each.name for each in choice(results, ["hover"]).places} == {"mahony", own["Tilted"]}
