"""What fails in a benchmark is a row with its reason and ends nothing else; hostile estimators never win."""

from concurrent.futures import BrokenExecutor

import pandas as pd
import pytest
from processes import square
from small_bench import small

from quadsim.runs.pool import run_all, run_stored
from scenarios.bench import cell as cell_module
from scenarios.bench import runner
from scenarios.bench.results import load_results
from scenarios.bench.verdict import choice, verdict


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

    monkeypatch.setattr(cell_module, "fly_mission", broken)
    results = small(tmp_path)
    reasons = [row.reason for row in results.rows]
    assert reasons == [f"{type(error).__name__}: no idea"] * 4
    assert load_results(tmp_path) == results
    assert pd.read_csv(tmp_path / "results.csv")["reason"].tolist() == reasons
    monkeypatch.undo()
    assert not any(row.reason for row in small(tmp_path).rows)  # and it is tried again


def test_dead_worker_is_a_row_with_its_reason(tmp_path, monkeypatch):
    def run(function, jobs, *options, **choices):
        for file, result in run_stored(function, jobs, *options, **choices):
            yield file, MemoryError("killed") if jobs[file][2] == "truth" else result

    monkeypatch.setattr(runner, "run_stored", run)
    rows = small(tmp_path).rows
    assert [row.reason for row in rows] == ["MemoryError: killed", ""] * 2


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
    names = ("NaN", "Huge", "Constant", "Tilted", "Peek", "Raises")
    own = {name: f"{tmp_path / 'est.py'}:{name}" for name in names}
    results = small(tmp_path / "out", scenarios=["hover"], names=["mahony", *own.values()], duration_s=3.0)
    reasons = {name: results.rows[1 + k].reason for k, name in enumerate(own)}
    assert "not a finite number" in reasons["NaN"]
    assert "angles beyond ±100 rad" in reasons["Huge"]
    assert reasons["Raises"] == "Raises: update ends with RuntimeError: no idea"
    assert results.unranked == {
        own["Peek"]: "received the true attitude",
        own["Constant"]: "returned the same roll and pitch at every sample",
    }
    assert verdict(results).headline.startswith("In hover, fly mahony")
    assert {each.name for each in choice(results, ["hover"]).places} == {"mahony", own["Tilted"]}
