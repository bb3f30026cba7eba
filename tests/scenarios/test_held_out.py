"""The held-out suite: drawn, not looked at, and out of reach of what learns."""

import re
from importlib.resources import files

import numpy as np
import pytest

from estimators.tuning.search import SearchSettings, tune
from quadsim.dataset.generation import generate
from quadsim.flight.recipe import load_recipe
from quadsim.held_out import SEEDS, load_held_out, releases, unreserved
from scenarios.bench.cell import FlightSettings
from scenarios.bench.experiment import draw_scenarios, load_experiment
from scenarios.bench.runner import bench
from training.epochs import train

NEWEST = load_held_out(releases()[-1])
SUITE = load_experiment("held-out")
LEARNING = (
    ["generate", "--out", "x.zarr"],
    ["train", "--data", "x.zarr"],
    ["tune", "mahony", "--data", "x.zarr"],
)


def test_the_newest_suite_is_of_this_version():
    text = (files("quadsim").joinpath("..", "pyproject.toml")).read_text()
    version = re.search(r'^version = "([^"]+)"', text, re.MULTILINE)[1]
    assert version.startswith(NEWEST.release)


def test_it_is_the_same_whenever_it_is_drawn_and_covers_every_level():
    drawn = SUITE.cases()
    assert (SUITE.seed, SUITE.seeds, len(drawn)) == (NEWEST.seed, NEWEST.flights, NEWEST.scenarios)
    assert drawn == SUITE.cases()
    for axis, levels in SUITE.axes.items():
        assert {case.levels[axis] for case in drawn.values()} == set(levels)
    wind = [np.linalg.norm(case.scenario.wind[0].velocity) for case in drawn.values()]
    assert NEWEST.wind[0] <= min(wind) < max(wind) <= NEWEST.wind[1]
    other = draw_scenarios(NEWEST.model_copy(update={"seed": NEWEST.seed + 1}), SUITE.axes)
    assert [case.scenario for case in other.values()] != [case.scenario for case in drawn.values()]


def test_it_is_that_of_the_release_to_the_last_digit():
    """Drawn when the release was: a change would make the recommendation that of other flights."""
    cases = SUITE.cases()
    assert cases["held-out-01"].scenario.trajectory.max_tilt_deg == 36.04695982189588
    assert cases["held-out-00"].scenario.trajectory.period_s == 6.181153971070838
    assert cases["held-out-00"].scenario.wind[1].wind_20ft == 9.488212380385196
    assert cases["held-out-31"].levels["IMU"] == "rough, vibration, lever arm"
    speeds = [np.linalg.norm(case.scenario.wind[0].velocity) for case in cases.values()]
    assert sum(speeds) == pytest.approx(162.74296198669606, rel=1e-12)


def test_a_reserved_seed_is_refused_and_its_neighbours_are_not():
    for seed in (NEWEST.seed, NEWEST.seed + SEEDS - 1):
        with pytest.raises(ValueError, match=rf"seed {seed} is of the held-out suite of {NEWEST.release}"):
            unreserved(seed)
    for seed in (0, NEWEST.seed - 1, NEWEST.seed + SEEDS):
        assert unreserved(seed) == seed


@pytest.mark.parametrize("command", LEARNING, ids=lambda command: command[0])
def test_no_verb_that_learns_takes_a_reserved_seed(refused, command):
    assert "is of the held-out suite" in refused(*command, "--seed", NEWEST.seed + 7)


def test_nothing_that_learns_takes_a_reserved_seed_from_python(tmp_path):
    reserved = NEWEST.seed + 7
    for learn in (
        lambda: generate(load_recipe("hummingbird"), 1, 1.0, tmp_path / "x.zarr", reserved),
        lambda: train(data="x.zarr", out=tmp_path / "run", seed=reserved),
        lambda: tune("mahony", [], SearchSettings(seed=reserved)),
    ):
        with pytest.raises(ValueError, match=rf"seed {reserved} is of the held-out suite"):
            learn()
    assert list(tmp_path.iterdir()) == []


def test_the_held_out_suite_itself_is_flown_with_its_seed(tmp_path):
    changes, settings = {"duration_s": 0.05}, FlightSettings(1, NEWEST.seed)
    results = bench(None, ["truth"], tmp_path, settings, changes, experiment=SUITE, workers=1)
    assert {cell.reason for cell in results.cells} == {""}
    assert results.levels == {name: case.levels for name, case in SUITE.cases().items()}
    with pytest.raises(ValueError, match="has scenarios of its own"):
        bench(["hover"], ["truth"], tmp_path, settings, experiment=SUITE)


def test_no_file_that_was_made_by_learning_names_a_reserved_seed():
    made = [*files("assets").joinpath("tuning").iterdir(), *files("assets").joinpath("presets").iterdir()]
    made += [each for each in files("assets").joinpath("weights").iterdir() if each.name.endswith(".md")]
    for file in made:
        seeds = map(int, re.findall(r"seed[ =:|]+(\d+)", file.read_text()))
        assert all(unreserved(seed) == seed for seed in seeds)
