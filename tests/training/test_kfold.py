"""K-fold and cross-domain training at a tiny size."""

import io
import shutil
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from estimators.networks.network import NetworkEstimator
from quadsim.cli import main
from quadsim.cli.options import time_left
from quadsim.dataset.generation import generate
from quadsim.flight.recipe import load_recipe
from training import kfold as kfold_module
from training.config import make_config
from training.data import flights_of, fold_split, load_training_flights
from training.kfold import TEST, TRAIN, best, kfold, table, terminal_table
from training.loop import DIVERGED
from training.loop import run as run_training

TINY = {
    "epochs": 2, "batches": 2, "batch_size": 2, "window_s": 0.5, "encoding": 12, "hidden": 10, "folds": 3,
}  # fmt: skip


@pytest.fixture(scope="module")
def domains(tmp_path_factory):
    folder = tmp_path_factory.mktemp("domains")
    return [
        generate(load_recipe(name), 4, 3.0, folder / f"{file}.zarr", seed=5, workers=1)
        for name, file in (("hummingbird", "train"), ("px4", "px4"))
    ]


def test_folds_test_every_flight_once_and_never_one_they_train_on():
    splits = [fold_split(35, 5, fold, seed=1) for fold in range(5)]
    for parts in splits:
        np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(35))
        assert [len(part) for part in parts] == [22, 6, 7]
    np.testing.assert_array_equal(np.sort(np.concatenate([test for _, _, test in splits])), np.arange(35))
    with pytest.raises(ValueError, match="5 folds need at least 5 flights, got 4"):
        fold_split(4, 5, 0, seed=1)
    with pytest.raises(ValueError, match="fold 5 of 5"):
        fold_split(35, 5, 5, seed=1)


def scored(model, errors, flawed=()):
    """Scores of the folds of a model on their test flights."""
    own = {"model": model, "trained_on": "a", "tested_on": TEST}
    return [
        own | {"fold": fold, "error_deg": error, "flaw": "diverged" * (fold in flawed)}
        for fold, error in enumerate(errors)
    ]


def test_a_model_with_a_flawed_fold_is_not_the_best_and_the_table_says_so():
    cells = table(scored("att-snn", [1.0, 2.0, 3.0], flawed=[1]) + scored("att-rnn", [3.0] * 3))
    numbers = [[cell[name] for name in ("folds", "mean_deg", "sd_deg", "flawed")] for cell in cells]
    assert numbers == [[3, 2.0, 1.0, 1], [3, 3.0, 0.0, 0]]
    assert best(cells)["model"] == "att-rnn"
    console = Console(width=200, file=io.StringIO())
    console.print(terminal_table(cells))
    assert "2.00 ± 1.00 (1 flawed)" in console.file.getvalue()
    with pytest.raises(ValueError, match="att-snn on a: 1 of 3"):
        best(cells[:1])


def test_a_fold_that_diverges_or_estimates_nothing_is_named(domains, tmp_path, monkeypatch):
    def diverging(config, out, progress):
        return replace(run_training(config, out, progress), reason=f"{DIVERGED}: the loss is nan")

    monkeypatch.setattr(kfold_module, "run", diverging)
    choices = TINY | {"epochs": 1, "folds": 2}
    scores = kfold(domains[:1], tmp_path / "a", workers=1, **choices)
    assert {score["flaw"] for score in scores} == {"training diverged: the loss is nan"}
    assert kfold(domains[:1], tmp_path / "a", workers=1, **choices) == scores  # read back
    monkeypatch.setattr(kfold_module, "run", run_training)
    monkeypatch.setattr(
        NetworkEstimator, "sequence", lambda self, gyro, accel: np.zeros((*gyro.shape[:2], 2))
    )
    scores = kfold(domains[:1], tmp_path / "b", workers=1, **choices)
    assert {score["flaw"] for score in scores} == {"returned the same roll and pitch at every sample"}


def test_every_fold_of_every_domain_is_trained_scored_and_kept(domains, tmp_path, monkeypatch):
    said = []
    scores = kfold(
        domains, tmp_path, models=("att-snn",), workers=1, progress=lambda *now: said.append(now), **TINY
    )
    assert [(s["trained_on"], s["fold"], s["tested_on"]) for s in scores] == [
        (here, fold, on)
        for here, there in (("px4", "train"), ("train", "px4"))
        for fold in range(3)
        for on in (TRAIN, TEST, there)
    ]
    assert {s["flights"] for s in scores if s["tested_on"] in ("train", "px4")} == {4}
    assert said[0][:2] == (0, 12)
    assert said[-1] == (12, 12, "6 of 6 folds done")
    assert pd.read_csv(tmp_path / "table1.csv").to_dict("records") == table(scores)

    shutil.rmtree(tmp_path / "att-snn--px4--2")  # what is missing is trained again, to the same weights
    trained = []
    monkeypatch.setattr(kfold_module, "run", lambda *a: trained.append(a[0].fold) or run_training(*a))
    assert kfold(domains, tmp_path, models=("att-snn",), workers=1, **TINY) == scores
    assert trained == [2]


def test_processes_give_the_same_scores(domains, tmp_path):
    choices = TINY | {"epochs": 1, "folds": 2}
    alone = kfold(domains[:1], tmp_path / "one", workers=1, **choices)
    assert kfold(domains[:1], tmp_path / "two", workers=2, **choices) == alone


def test_a_fold_trains_validates_and_tests_on_different_flights(domains):
    parts = flights_of(make_config(data=domains[0], folds=4, fold=1, window_s=1.0))
    assert [len(part) for part in parts] == [2, 1, 1]
    everything = load_training_flights([domains[0]]).gyro[:, 0]
    np.testing.assert_array_equal(
        np.unique(np.concatenate([part.gyro[:, 0] for part in parts]), axis=0), np.unique(everything, axis=0)
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"folds": 1}, "fold 0 of 1"),
        ({"folds": 9}, "9 folds need at least 9 flights, got 4"),
        ({"validation": "x.zarr"}, "validation follows from the folds"),
        ({"batches": 0}, "training: batches = 0"),
        ({"models": ["att"]}, 'training: model = "att"'),
    ],
)
def test_mistakes_are_said_before_anything_is_trained(domains, tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        kfold(domains, tmp_path / "out", **TINY | change)
    assert not (tmp_path / "out").exists()
    with pytest.raises(ValueError, match="each needs a name of its own"):
        kfold([domains[0], domains[0]], tmp_path / "out", **TINY)


def test_command_prints_table_1(domains, tmp_path, monkeypatch, capsys):
    chosen = [f"--set={name}={value}" for name, value in TINY.items() if name != "folds"]
    here, there = ([f"--data={path}"] for path in domains)
    arguments = [*here, *there, f"--out={tmp_path}", "--preset=paper", "--folds=2", "--workers=1", *chosen]
    monkeypatch.setattr(sys, "argv", ["quadsim", "train", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    out = capsys.readouterr().out
    assert "all of px4" in out
    assert out.count("±") == 8  # six cells, the title and the last line
    assert "over 2 folds" in out.splitlines()[-1]


def test_time_left():
    assert [time_left(10, 1, 5), time_left(600, 1, 10), time_left(3600, 10, 500)] == [
        "40 s",
        "90 min",
        "49.0 h",
    ]
