"""A task that others enter: its data, what an entry gets, what is refused, and the leaderboard."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from accessibility import findings
from scipy.io import savemat
from task_entries import BAD, FAIR, LEVEL, LOOP, TASK, TILTED

from estimators import check_estimator, create
from estimators.evaluation.flights import load_flights
from estimators.metrics import inclination_rmse
from estimators.running import run
from estimators.tuning.search import SearchSettings, tune
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe
from quadsim.held_out import load_held_out, unreserved
from quadsim.rotation import quat_conjugate, quat_from_euler, quat_multiply
from scenarios.bench.cell import FlightSettings
from scenarios.bench.experiment import load_experiment
from scenarios.bench.runner import bench
from scenarios.report.leaderboard import (
    closed_loop_flights,
    find_entries,
    improvement,
    loop_errors,
    standing,
    write_leaderboard,
)
from scenarios.task.entry import ENTRY, card_of, load_entry
from scenarios.task.operations import counted_operations
from scenarios.task.run_task import run_task
from scenarios.task.specification import load_task
from scenarios.task.task_data import make_data
from training.data import load_training_flights

SHIPPED = load_task("attitude-1")
BASELINES = Path(__file__).parents[2] / "examples" / "baselines"


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a small task, the entries of strangers, and what two entries got."""
    folder = tmp_path_factory.mktemp("task")
    (folder / "level.toml").write_text(LEVEL)
    (folder / "tilted.toml").write_text(TILTED)
    (folder / "loop.toml").write_text(LOOP.format(folder=folder))
    (folder / "small.toml").write_text(TASK.format(folder=folder))
    (folder / "mine.py").write_text(FAIR)
    small = load_task(folder / "small.toml")
    run_task(small, ["mahony", f"{folder}/mine.py:Mine"], folder / "out", workers=1)
    return folder


@pytest.fixture(scope="module")
def task(place):
    return load_task(place / "small.toml")


def only_home(task):
    """The small task with one part of its data."""
    return task.model_copy(update={"recipes": {"home": task.recipes["home"]}})


def named(entry, name):
    """An entry under another name."""
    return replace(entry, card=replace(entry.card, name=name))


def entered(place, name, source=FAIR):
    (place / f"{name.lower()}.py").write_text(source)
    small = load_task(place / "small.toml")
    (entry,) = run_task(small, [f"{place}/{name.lower()}.py:{name}"], place / "out", workers=1)
    assert load_entry(place / "out" / name / "entry.json") == entry
    return entry


def test_every_seed_of_the_task_is_reserved_and_used_once():
    first = load_held_out(SHIPPED.release).seed
    seeds = [SHIPPED.seed_of(part) + k for part in SHIPPED.parts for k in range(20)]
    assert len({first, *seeds}) == len(seeds) + 1
    for seed in seeds:
        with pytest.raises(ValueError, match="is of the held-out suite"):
            unreserved(seed)


def test_what_learns_refuses_the_data_of_a_task(place, tmp_path):
    data = place / "out" / "data" / "home.zarr"
    for learn in (
        lambda: load_training_flights([data]),
        lambda: tune("mahony", [open_dataset(data)], SearchSettings(iterations=1)),
        lambda: generate(load_recipe("hummingbird"), 1, 1.0, tmp_path / "x.zarr", SHIPPED.seed_of("home")),
    ):
        with pytest.raises(ValueError, match=r"is of the held-out suite of 0\.3"):
            learn()


def test_the_data_are_the_same_wherever_they_are_made(place, task, tmp_path):
    made = make_data(task, tmp_path, None, 1, lambda *_: None)
    assert made == load_entry(place / "out" / "mahony" / "entry.json").data
    assert len(set(made.values())) == len(made)


def test_an_entry_on_other_data_is_not_ranked(place, task):
    other = only_home(task).model_copy(update={"digests": {"home": "0" * 64}})
    (entry,) = run_task(other, ["mahony"], place / "other", workers=1)
    assert entry.reasons == ("ran on data that differ from the task's (home)",)


def test_broad_is_scored_by_its_authors_metric_where_all_its_trials_are_there(task, tmp_path):
    """Laidig et al. 2021: RMS of 2 arccos √(w² + z²) of the error in world axes, over what is marked."""
    time = np.arange(0.0, 8.0, 7.0 / 2000.0)
    quat = quat_from_euler(0.5 * np.sin(time), 0.3 * np.sin(2.0 * time), 0.2 * time)
    readings = {"imu_gyr": np.zeros((time.size, 3)), "imu_acc": np.tile([0.0, 0.0, 9.81], (time.size, 1))}
    moving = (time > 1.0) & (time < 3.0)
    trial = {"opt_quat": quat, "movement": moving, "sampling_rate": 2000.0 / 7.0}
    readings["imu_mag"] = np.ones((time.size, 3))
    savemat(tmp_path / "01_undisturbed_slow_rotation_A.mat", readings | trial)
    small = only_home(task).model_copy(update={"broad_trials": SHIPPED.broad_trials})
    entries = [f"{BASELINES}/level.py:Level"]
    (entry,) = run_task(small, entries, tmp_path / "out", recordings=tmp_path, workers=1)
    error = quat_multiply([1.0, 0.0, 0.0, 0.0], quat_conjugate(quat[moving]))
    angle = np.degrees(2.0 * np.arccos(np.hypot(error[:, 0], error[:, 3])))
    (value,) = entry.parts["broad"].values.values()
    assert value == pytest.approx(np.sqrt(np.mean(angle**2)), rel=2e-3)
    assert (entry.parts["broad"].errors, entry.parts["broad"].note) == (None, "1 of 39 trials")
    small = small.model_copy(update={"broad_trials": 1})
    (entry,) = run_task(small, entries, tmp_path / "out", recordings=tmp_path, workers=1)
    assert entry.parts["broad"].errors.mean == value
    with np.load(tmp_path / "out" / "data" / "broad" / "01_undisturbed_slow_rotation_A.npz") as made:
        np.testing.assert_allclose(made["mag"][10:-10], 1e-6)


def test_an_entry_has_the_errors_of_its_runs(place, task):
    entry = load_entry(place / "out" / "mahony" / "entry.json")
    flights = load_flights([open_dataset(place / "out" / "data" / "home.zarr")])
    flights.truth[:, :200] = np.nan
    errors = inclination_rmse(run(create("mahony"), flights.gyro, flights.accel), flights.truth)
    assert list(entry.parts["home"].values.values()) == errors.sequences.tolist()
    assert entry.parts["home"].errors.mean == errors.mean
    loop = load_experiment(place / "loop.toml")
    flown = bench(None, ["mahony"], place / "again", FlightSettings(2, loop.seed), experiment=loop, workers=1)
    assert [each.error_deg for each in entry.flights] == flown.flights["error_deg"].tolist()
    assert loop_errors(entry).mean == flown.totals["mahony"].error_deg
    assert ([each.cause for each in entry.flights], entry.reasons) == ([""] * 4, ())
    assert entry.card.track == "IMU"
    assert entry.cost.ns > 0.0
    assert entry.cost.footprint > 100


def test_a_run_that_was_stopped_goes_on_where_it_was(place, task, monkeypatch):
    before = load_entry(place / "out" / "Mine" / "entry.json")
    monkeypatch.setattr("scenarios.task.run_task.examine", None)
    monkeypatch.setattr("scenarios.task.run_task.score_part", None)
    monkeypatch.setattr("scenarios.bench.runner.fly_cell", None)
    with monkeypatch.context() as patch:
        patch.setattr("scenarios.task.run_task.fly_entry", lambda *_: ((), ["did not fly"]))
        (unfit,) = run_task(task, [f"{place}/mine.py:Mine"], place / "out", workers=1)
    assert unfit.reasons == ("did not fly",)
    assert run_task(task, [f"{place}/mine.py:Mine"], place / "out", workers=1) == [before]


def test_an_entry_is_given_what_its_card_declares_and_nothing_else(place):
    told = FAIR.replace("Mine", "Told")
    told = told.replace("rate_hz):", "rate_hz, vehicle):\n        self.lost = vehicle is None")
    told = told.replace("return self.angle.copy()", "return self.angle + 0.5 * self.lost")
    entry = entered(place, "Told", told.replace("given = ()", 'given = ("airframe", "initial attitude")'))
    assert entry.card.track == "IMU + airframe + initial attitude"
    assert entry.reasons == ()
    assert entry.parts["home"].errors.mean < 15.0
    assert entry.parts["hand"].note == "there is no airframe to be given"
    plain = load_entry(place / "out" / "Mine" / "entry.json")
    assert entry.flights[2].error_deg < 0.5 * plain.flights[2].error_deg  # which begins tilted
    asks = FAIR.replace("Mine", "Asks").replace("(self, gyro, accel)", "(self, gyro, accel, rotor_vel=None)")
    assert entered(place, "Asks", asks).card.given == ("rotor_vel",)
    with pytest.raises(ValueError, match='given = "airfame"; did you mean "airframe"'):
        entered(place, "Typo", FAIR.replace("Mine", "Typo").replace("()  #", '("airfame",)  #'))


@pytest.mark.parametrize(("name", "change", "reason"), BAD, ids=[name for name, _, _ in BAD])
def test_an_entry_that_breaks_a_rule_is_listed_with_the_reason_and_not_ranked(place, name, change, reason):
    source = FAIR.replace("Mine", name).replace(*(each.format(folder=place) for each in change))
    assert source != FAIR.replace("Mine", name)
    entry = entered(place, name, source)
    assert reason in "; ".join(entry.reasons)
    assert standing([entry], closed_loop_flights([entry])) == []


def test_two_entries_of_one_name_are_refused(place, task):
    (place / "other.py").write_text(FAIR)
    sources = [f"{place}/mine.py:Mine", f"{place}/other.py:Mine"]
    with pytest.raises(ValueError, match="two entries have one name"):
        run_task(task, sources, place / "out", workers=1)


def test_an_entry_that_hangs_is_ended(place, monkeypatch):
    monkeypatch.setattr("scenarios.task.examination.PATIENCE_S", 0.5)
    hangs = FAIR.replace("Mine", "Hangs").replace("gyro = np", "while True: pass\n        gyro = np")
    assert "took more than 0.5 s" in entered(place, "Hangs", hangs).reasons[0]


def test_operations_of_a_network_and_in_the_source_of_a_filter_are_counted(place, task):
    (entry,) = run_task(only_home(task), ["att-snn"], place / "net", workers=1)
    assert entry.cost.operations > 100.0
    assert entry.cost.nanojoules > 1.0
    assert "Davies" in entry.cost.model
    assert entry.card.parameter_count > 100
    mine = load_entry(place / "out" / "Mine" / "entry.json")
    assert (mine.cost.operations, mine.cost.nanojoules) == (30.0, pytest.approx(30.0 * 2.3e-3))
    assert mine.cost.model.startswith("as its class says")
    assert counted_operations(mine.card.source, 200.0) == 13.0  # 3 angles, 3 for gyro, 7 for the mean
    filtered = load_entry(place / "out" / "mahony" / "entry.json")
    assert 50.0 < filtered.cost.operations < 500.0
    assert filtered.cost.model.startswith("counted in its Python source")


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("vqf", "vqf_package.py:Vqf"),
        ("imufusion", "imufusion_package.py:Fusion"),
        ("ahrs", "ahrs_package.py:AhrsMadgwick"),
        ("riann", "riann_package.py:Riann"),
    ],
)
def test_every_baseline_is_a_sound_entry(package, source):
    pytest.importorskip(package)
    check_estimator(f"{BASELINES}/{source}")
    card = card_of(f"{BASELINES}/{source}", 200.0)
    assert card.track == "IMU"
    assert {name.lower() for name in card.packages} >= {package.replace("riann", "onnxruntime")}


def test_the_probability_of_improvement_counts_paired_flights(place):
    entries = find_entries([place / "out"])
    mine, other = (load_entry(place / "out" / name / "entry.json") for name in ("Mine", "mahony"))
    better = [float(a.error_deg < b.error_deg) for a, b in zip(mine.flights, other.flights, strict=True)]
    assert improvement(closed_loop_flights(entries), "Mine", "mahony").mean == pytest.approx(np.mean(better))
    crashed = replace(mine.flights[0], cause="tilt", error_deg=0.0)
    fallen = replace(named(mine, "Fallen"), flights=(crashed, *mine.flights[1:]))
    assert loop_errors(fallen).sequences[0] == mine.flights[1].error_deg
    flights = closed_loop_flights([mine, fallen])
    assert improvement(flights, "Fallen", "Mine").mean == pytest.approx(0.5 * 3 / 4)
    assert standing([fallen, mine], flights) == ["Mine", "Fallen"]


def test_entries_of_another_task_or_code_have_a_table_of_their_own(place, tmp_path, browser):
    mine = load_entry(place / "out" / "Mine" / "entry.json")
    for name, change in {"task": {"task": "1" * 64}, "code": {"code": "2" * 64}, "same": {}}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "entry.json").write_bytes(ENTRY.dump_json(replace(mine, **change)))
    flawed = replace(named(mine, "Flawed"), code="2" * 64, reasons=("opened <a file>",))
    (tmp_path / "entry.json").write_bytes(ENTRY.dump_json(flawed))
    page = write_leaderboard(tmp_path / "board.html", find_entries([tmp_path])).read_text()
    assert page.count("<h2>small (task") == 3
    assert 'Flawed<br><small class="failed">not ranked: it opened &lt;a file&gt;' in page
    assert "task 11111111" in page
    assert "code 22222222" in page
    shown = browser.new_page()
    shown.goto((tmp_path / "board.html").as_uri())
    shown.click("table >> nth=2 >> th button >> nth=0")
    assert shown.get_attribute("table >> nth=2 >> th >> nth=0", "aria-sort") == "ascending"
    assert findings(shown) == []
    shown.close()


def test_the_command_runs_a_task_and_merges_folders(place, printed, refused, tmp_path):
    run_it = ("bench", "--task", place / "small.toml", "--out", place / "out", "--workers", 1)
    printed(*run_it, "--estimator", "mahony")
    (own,) = find_entries([place / "out" / "mahony"])
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "entry.json").write_bytes(ENTRY.dump_json(named(own, "Of a colleague")))
    shown = printed("report", place / "out" / "mahony", tmp_path / "other", "--out", tmp_path / "b.html")
    assert "IMU:" in shown
    assert "leads (2 entries are ranked)" in shown
    alone = printed("report", place / "out" / "mahony", "--out", tmp_path / "c.html")
    assert "mahony is the only ranked entry" in alone
    assert "Of a colleague" in (tmp_path / "b.html").read_text()
    for more, why in {
        ("--seeds", 3): "--seeds cannot be combined with --task",
        ("--set", "rate=100"): 'unknown key "rate"; valid: broad',
        (): "give at least one --estimator",
    }.items():
        assert why in refused(*run_it, *more, *(("--estimator", "mahony") if more else ()))
    (tmp_path / "empty").mkdir()
    assert "contains no entry" in refused("report", tmp_path / "empty", tmp_path / "empty")
