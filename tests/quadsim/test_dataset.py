import errno
import json
import os
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from small_dataset import CONFIG, DURATION, FLIGHTS, STEPS, files

from quadsim.dataset import generation as dataset
from quadsim.dataset import store as dataset_store
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import dataset_info, open_dataset, verify
from quadsim.dataset.store import VARIABLES, partial_folder
from quadsim.flight.recipe import Recipe
from quadsim.flight.simulate import simulate_flights
from quadsim.runs import pool


def digests(path: Path) -> list[str]:
    return json.loads((path / dataset_store.DIGESTS).read_text())["content"]["flights"]


def interrupted(out: Path) -> Path:
    """A dataset whose generation failed at flight 4."""

    def fly(plan, folder, flights):
        if flights == [4]:
            raise OSError(errno.ENOSPC, "No space left on device")
        return dataset_store.fly_batch(plan, folder, flights)

    stubbed = SimpleNamespace(**vars(dataset_store) | {"fly_batch": fly})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dataset, "BATCH_FLIGHTS", 1)
        patch.setattr(dataset, "dataset_store", stubbed)
        with pytest.raises(OSError, match=r"cannot write .*No space left on device.* are kept"):
            generate(CONFIG, FLIGHTS, DURATION, out, workers=1)
    return out


def test_variables_and_coordinates_are_labelled_and_the_configuration_is_inside(finished):
    found = open_dataset(finished)
    assert set(found.data_vars) == set(VARIABLES)
    for name, variable in VARIABLES.items():
        assert found[name].dims == ("flight", "time", variable.dim)
        assert found[name].shape[:2] == (FLIGHTS, STEPS)
        assert found[name].attrs == {"units": variable.units, "long_name": variable.long_name}
    assert found["time"].to_numpy() == pytest.approx(np.arange(STEPS) / 200)
    assert found["time"].attrs["units"] == "s"
    assert found["flight"].to_numpy().tolist() == list(range(FLIGHTS))
    assert [*found["quat_axis"].to_numpy(), *found["axis"].to_numpy()] == [*"wxyz", *"xyz"]
    assert (found["valid_steps"] == STEPS).all()
    assert (found["end_reason"] == "").all()
    assert Recipe.model_validate_json(found.attrs["config"]) == CONFIG
    assert [found.attrs[key] for key in ("seed", "rate_hz", "duration_s")] == [0, 200.0, DURATION]


def test_a_flight_is_the_simulation_of_its_own_seed(finished):
    alone = simulate_flights(CONFIG, [np.random.SeedSequence(0).spawn(FLIGHTS)[4]], STEPS, 200.0)
    found = open_dataset(finished).isel(flight=4)
    for name in VARIABLES:
        assert np.array_equal(found[name].to_numpy(), alone[name][0].astype("f4"))


def test_bytes_do_not_depend_on_the_batches(finished, tmp_path, monkeypatch):
    monkeypatch.setattr(dataset, "BATCH_FLIGHTS", 3)
    assert files(generate(CONFIG, FLIGHTS, DURATION, tmp_path / "x.zarr", workers=1)) == files(finished)


def test_a_larger_dataset_begins_with_the_same_flights_and_another_seed_gives_others(finished, tmp_path):
    larger = generate(CONFIG, FLIGHTS + 1, DURATION, tmp_path / "y.zarr", workers=1)
    assert digests(larger)[:FLIGHTS] == digests(finished)
    other = generate(CONFIG, FLIGHTS, DURATION, tmp_path / "z.zarr", seed=1, workers=1)
    assert not set(digests(other)) & set(digests(finished))


def test_a_rerun_flies_only_what_is_missing(finished, tmp_path, monkeypatch):
    out = interrupted(tmp_path / "x.zarr")
    flown, progress = [], []

    def counting(config, seeds, steps, rate_hz):
        flown.extend(seed.spawn_key[0] for seed in seeds)
        return simulate_flights(config, seeds, steps, rate_hz)

    monkeypatch.setattr(dataset_store, "simulate_flights", counting)
    generate(CONFIG, FLIGHTS, DURATION, out, workers=1, progress=lambda *done: progress.append(done))
    assert flown == [4, 5, 6]
    assert progress == [(4, 7), (7, 7)]
    assert files(out) == files(finished)
    assert not partial_folder(out).exists()


def test_a_flight_whose_file_was_cut_short_is_flown_again(finished, tmp_path):
    out = interrupted(tmp_path / "x.zarr")
    os.truncate(dataset_store.chunk_file(partial_folder(out) / "data", "wind", 2), 10)
    flights = partial_folder(out) / "flights"
    (flights / "00003.json").write_text("{")
    (flights / ".00005.1.part.json").write_text("{")  # what a killed worker left half written
    with pytest.raises(ValueError, match="2 of 7"):
        open_dataset(out)
    assert files(generate(CONFIG, FLIGHTS, DURATION, out, workers=1)) == files(finished)


def test_a_finished_dataset_is_left_as_it_is(finished):
    before = (finished / "zarr.json").stat().st_mtime_ns
    assert generate(CONFIG, FLIGHTS, DURATION, finished, workers=1) == finished
    assert (finished / "zarr.json").stat().st_mtime_ns == before


def test_a_killed_run_resumes_and_leaves_no_process_behind(tmp_path):
    script = """
import sys
from quadsim import dataset
from quadsim.flight.recipe import Recipe

dataset.BATCH_FLIGHTS = 1
dataset.generate(Recipe.model_validate_json(sys.argv[2]), 40, 1.0, sys.argv[1], workers=2)
"""
    out = tmp_path / "killed.zarr"
    command = [sys.executable, "-c", script, str(out), CONFIG.model_dump_json()]
    run = subprocess.Popen(command, cwd=Path(__file__).parents[2])
    markers = partial_folder(out) / "flights"
    while len(list(markers.glob("*.json"))) < 3:
        assert run.poll() is None
        time.sleep(0.02)
    workers = psutil.Process(run.pid).children()
    run.kill()
    run.wait()
    assert len(psutil.wait_procs(workers, timeout=60)[0]) >= 2
    assert not any(worker.is_running() for worker in workers)
    for path in (out, partial_folder(out)):
        with pytest.raises(ValueError, match=r"is unfinished: \d+ of 40 flights; rerun"):
            open_dataset(path)
    generate(CONFIG, 40, 1.0, out, workers=1)
    assert verify(out) == 40
    assert not list(out.rglob("*.tmp"))
    whole = generate(CONFIG, 40, 1.0, tmp_path / "whole.zarr", workers=1)
    assert files(out) == files(whole)


def test_a_worker_that_dies_is_one_clear_error(tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "run_all", lambda *_: (each for each in [(0, BrokenExecutor())]))
    with pytest.raises(ChildProcessError, match=r"a worker process died .*; finished work is kept"):
        generate(CONFIG, FLIGHTS, DURATION, tmp_path / "x.zarr", workers=7)


def test_another_dataset_is_not_continued_nor_replaced(own, tmp_path):
    unfinished = interrupted(tmp_path / "unfinished.zarr")
    for out in (own, unfinished):
        with pytest.raises(ValueError, match=r"another dataset \(seed is 0, not 3\).*--out.*--overwrite"):
            generate(CONFIG, FLIGHTS, DURATION, out, seed=3, workers=1)
    longer = CONFIG.model_copy(update={"warmup_s": 1.0})
    with pytest.raises(ValueError, match=r"config.warmup_s is 0.5, not 1.0"):
        generate(longer, FLIGHTS, DURATION, own, workers=1)


def test_overwrite_replaces_finished_and_unfinished_datasets(own, tmp_path):
    for out in (own, interrupted(tmp_path / "unfinished.zarr")):
        generate(CONFIG, 2, DURATION, out, seed=3, workers=1, overwrite=True)
        assert open_dataset(out).sizes["flight"] == 2
        assert not partial_folder(out).exists()


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_is_not_a_dataset_is_never_replaced(tmp_path, overwrite):
    for folder in ("thesis", "y.zarr.partial"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "chapter").touch()
    for name in ("thesis", "y.zarr"):
        with pytest.raises(ValueError, match=r"is not a dataset of quadsim|was not written by quadsim"):
            generate(CONFIG, 2, DURATION, tmp_path / name, workers=1, overwrite=overwrite)
    assert len(files(tmp_path)) == 2


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"flights": 0}, "flights = 0: should be 1 to"),
        ({"duration_s": 0.0}, "duration_s = 0.0"),
        ({"seed": -1}, "seed = -1"),
        ({"workers": 0}, "workers = 0"),
    ],
)
def test_bad_arguments_are_named(tmp_path, wrong, message):
    arguments = {"flights": 1, "duration_s": 1.0, "out": tmp_path / "x.zarr"} | wrong
    with pytest.raises(ValueError, match=message):
        generate(CONFIG, **arguments)
    assert not list(tmp_path.iterdir())


def test_a_diverging_flight_ends_with_a_reason_and_holds_its_last_sample(tmp_path, monkeypatch):
    def diverging(config, seeds, steps, rate_hz):
        log = simulate_flights(config, seeds, steps, rate_hz)
        log["end_step"][1], log["end_reason"][1] = 30, "hit the ground"
        log["position"][1, 30:] = np.nan
        log["velocity"][2, 40] = np.inf  # the simulation itself did not notice
        log["end_step"][3], log["end_reason"][3] = 0, "never flew"
        log["gyro"][3] = np.nan
        return log

    monkeypatch.setattr(dataset_store, "simulate_flights", diverging)
    found = open_dataset(generate(CONFIG, 4, DURATION, tmp_path / "x.zarr", workers=1)).load()
    assert found["valid_steps"].to_numpy().tolist() == [STEPS, 30, 40, 0]
    assert found["end_reason"].to_numpy().tolist()[:2] == ["", "hit the ground"]
    assert "not finite" in str(found["end_reason"][2].item())
    assert all(np.isfinite(found[name]).all() for name in VARIABLES)
    for flight, end in ((1, 30), (2, 40)):
        for name in VARIABLES:
            values = found[name].to_numpy()[flight]
            assert (values[end:] == values[end - 1]).all()
    assert (found["quat"][3] == [1, 0, 0, 0]).all()
    assert verify(tmp_path / "x.zarr") == 4
    assert dataset_info(tmp_path / "x.zarr")["flights_ended_early"] == 3


def test_a_dataset_of_other_code_is_not_taken_for_this_one(tmp_path, monkeypatch):
    generate(CONFIG, 1, 0.1, tmp_path / "x.zarr", workers=1)
    generate(CONFIG, 1, 0.1, tmp_path / "x.zarr", workers=1)
    monkeypatch.setattr(dataset, "code_digest", lambda *names: "other")
    with pytest.raises(ValueError, match="it was made by other code"):
        generate(CONFIG, 1, 0.1, tmp_path / "x.zarr", workers=1)
    generate(CONFIG, 1, 0.1, tmp_path / "x.zarr", workers=1, overwrite=True)
