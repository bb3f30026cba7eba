"""The held-out suite: drawn, not looked at, and out of reach of what learns."""

import re
import sys
from importlib.resources import files

import numpy as np
import pytest

from estimators.tuning.search import SearchSettings, tune
from quadsim.cli import main
from quadsim.dataset.generation import generate
from quadsim.flight.recipe import load_recipe
from quadsim.held_out import SEEDS, load_held_out, releases, unreserved
from scenarios.bench.axes import AXES
from scenarios.bench.held_out import suite
from scenarios.bench.runner import bench
from scenarios.bench.settings import FlightSettings, ScenarioChanges
from training.loop import train

NEWEST = load_held_out(releases()[-1])
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
    drawn = suite(NEWEST)
    assert len(drawn) == NEWEST.scenarios
    assert drawn == suite(NEWEST)
    for axis, levels in AXES.items():
        assert {combination.levels[axis] for combination, _ in drawn.values()} == set(levels)
    wind = [np.linalg.norm(scenario.wind[0].velocity) for _, scenario in drawn.values()]
    assert NEWEST.wind[0] <= min(wind) < max(wind) <= NEWEST.wind[1]
    other = suite(NEWEST.model_copy(update={"seed": NEWEST.seed + 1}))
    assert [s for _, s in other.values()] != [s for _, s in drawn.values()]


def test_a_reserved_seed_is_refused_and_its_neighbours_are_not():
    for seed in (NEWEST.seed, NEWEST.seed + SEEDS - 1):
        with pytest.raises(ValueError, match=rf"seed {seed} is of the held-out suite of {NEWEST.release}"):
            unreserved(seed)
    for seed in (0, NEWEST.seed - 1, NEWEST.seed + SEEDS):
        assert unreserved(seed) == seed


@pytest.mark.parametrize("command", LEARNING, ids=lambda command: command[0])
def test_no_verb_that_learns_takes_a_reserved_seed(monkeypatch, capsys, command):
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.setattr(sys, "argv", ["quadsim", *command, "--seed", str(NEWEST.seed + 7)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "is of the held-out suite" in capsys.readouterr().err


RESERVED = rf"seed {NEWEST.seed + 7} is of the held-out suite"


def test_nothing_that_learns_takes_a_reserved_seed_from_python(tmp_path):
    with pytest.raises(ValueError, match=RESERVED):
        generate(load_recipe("hummingbird"), 1, 1.0, tmp_path / "x.zarr", NEWEST.seed + 7)
    with pytest.raises(ValueError, match=RESERVED):
        train(data="x.zarr", out=tmp_path / "run", seed=NEWEST.seed + 7)
    with pytest.raises(ValueError, match=RESERVED):
        tune("mahony", [], SearchSettings(seed=NEWEST.seed + 7))
    assert list(tmp_path.iterdir()) == []


def test_the_held_out_suite_itself_is_flown_with_its_seed(tmp_path):
    name, (_, scenario) = next(iter(suite(NEWEST).items()))
    changes = ScenarioChanges(duration_s=0.1)
    results = bench({name: scenario}, ["truth"], tmp_path, FlightSettings(1, NEWEST.seed), changes, workers=1)
    assert [cell.reason for cell in results.cells] == [""]


def test_no_file_that_was_made_by_learning_names_a_reserved_seed():
    made = [*files("assets").joinpath("tuning").iterdir(), *files("assets").joinpath("presets").iterdir()]
    made += [each for each in files("assets").joinpath("weights").iterdir() if each.name.endswith(".md")]
    for file in made:
        seeds = map(int, re.findall(r"seed[ =:|]+(\d+)", file.read_text()))
        assert all(unreserved(seed) == seed for seed in seeds)
