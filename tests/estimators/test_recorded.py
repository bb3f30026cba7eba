"""Scores on recorded logs: what counts, what a level guess makes, and what a known bias is worth."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from level import Level
from sensor import noisy, readings

from estimators import create
from estimators.evaluation.logs import KNOWN, LEVEL, RAW, SILENCED, default_names, prepared, score_logs
from estimators.evaluation.without_truth import compare, horizontal_force
from quadsim.logs import read_log
from quadsim.logs.mounting import estimate_mount
from quadsim.logs.recording import Recording, mount_matrix, mounted
from quadsim.logs.resample import resample
from quadsim.logs.truth import bias_by_truth
from quadsim.rotation import quat_from_euler, quat_from_rotvec, quat_multiply, roll_pitch_from_quat
from quadsim.vehicle import GRAVITY
from scenarios.log_report.log_page import write_log_report
from scenarios.log_report.log_verdict import log_verdict

FILTERS = ("mahony", "madgwick", "complementary", "eskf", "vqf")
BIAS = np.array([0.06, -0.02, 0.01])


@pytest.fixture(scope="module")
def log(make_flights):
    """A log of twenty seconds with a biased gyroscope, in which one second is lost."""
    flight = make_flights(flights=1, seed=3, noise=0.0)
    gyro, accel, quat = (flight[name].to_numpy()[0] for name in ("gyro", "accel", "quat"))
    time = np.arange(len(gyro)) / 200.0
    kept = np.abs(time - 10.0) > 0.5
    recorded = Recording("mine", "x", time[kept], gyro[kept] + BIAS, accel[kept], "x", time, quat)
    return resample(recorded)[0]


def test_level_is_the_root_mean_square_of_the_tilt(log):
    rows = score_logs([log], ["mahony"], within_deg=180.0).table
    tilt = np.degrees(np.arccos(np.cos(roll_pitch_from_quat(log["quat"][0])).prod(axis=1)))
    tilt = tilt[np.isfinite(log["gyro"][0]).all(axis=1)][600:]
    for row in rows[:2].itertuples():  # 17 s after the start, of which one is a gap
        assert (row.estimator, row.scored_s) == (LEVEL, pytest.approx(16.0, abs=0.01))
        assert row.inclination_rmse_deg == pytest.approx(np.sqrt(np.mean(tilt**2)), rel=1e-9)


def test_missing_samples_are_said_once_with_the_name_of_the_log(log, caplog):
    score_logs([log], ["mahony", "vqf", "att-snn"])
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("mine: 201 of 4000 samples")


def test_only_known_upright_and_marked_samples_count(log):
    half = log.copy(deep=True)
    half["scored"][0, 2000:] = False
    scored_s = score_logs([half], ["mahony"], within_deg=15.0).table.scored_s
    tilt = np.degrees(np.arccos(np.cos(roll_pitch_from_quat(log["quat"][0])).prod(axis=1)))
    recorded = np.isfinite(log["gyro"][0]).all(axis=1)
    assert scored_s[0] == pytest.approx(((tilt <= 15) & recorded)[600:2000].sum() / 200)


def test_the_bias_is_read_off_the_truth_and_taking_it_off_helps():
    time = np.arange(4000) / 200.0
    gyro, accel, quat = readings(time, 0.3 * np.sin(time), 0.0, 0.0)
    held = resample(Recording("held", "x", time, gyro + BIAS, accel, "x", time, quat))[0]
    scores = score_logs([held], {"mahony": create("mahony", k_p=1.0, k_i=0.0)})
    np.testing.assert_allclose(scores.logs["held"].bias.mean, BIAS, atol=1e-4)
    # a proportional filter follows a bias of b to b / k_p
    assert scores.mean("mahony", RAW) == pytest.approx(np.degrees(np.hypot(0.06, 0.02)), rel=0.1)
    assert scores.mean("mahony", KNOWN) < 0.1
    assert scores.estimators == ["mahony", LEVEL]


def test_a_fast_turn_has_the_bias_of_a_slow_one():
    time = np.arange(2000) / 200.0
    quat = quat_from_euler(0.0 * time, 0.0 * time, 0.4 * time)
    gyro = np.tile([0.0, 0.0, 0.4], (2000, 1)) + BIAS
    np.testing.assert_allclose(bias_by_truth(gyro, quat, 200.0).mean, BIAS, atol=1e-6)
    assert np.isnan(bias_by_truth(gyro[:100], quat[:100], 200.0).mean).all()


@pytest.mark.parametrize("seed", range(2))
def test_a_bias_against_a_noisy_truth_is_within_its_interval(seed):
    bias = np.radians([1.5, -1.0, 0.0])
    found = bias_by_truth(*(noisy(bias, seed=seed)[name].to_numpy()[0] for name in ("gyro", "quat")), 200.0)
    np.testing.assert_allclose(found.mean, bias, atol=np.radians(0.2))
    assert (np.abs(found.mean - bias) < found.half_width).all()
    assert (found.half_width < np.radians(0.8)).all()
    assert found.significant.tolist() == [found.mean[0], found.mean[1], 0.0]


def test_a_bias_is_removed_where_it_is_significant_and_the_report_says_where_not(tmp_path):
    held, biased = noisy(np.zeros(3)), noisy(np.radians([2.0, 0.0, 0.0]), seed=1)
    biased.attrs["source"] = "biased"
    scores = score_logs([held, biased], {"mahony": create("mahony", k_p=1.0, k_i=0.0)})
    raw, known = (scores.on_logs(bias).loc["mahony"] for bias in (RAW, KNOWN))
    assert known["noisy"] == raw["noisy"]
    assert known["biased"] < raw["biased"] - 0.2
    assert scores.logs["noisy"].bias_text.endswith("not significant, nothing is removed")
    assert scores.logs["biased"].bias_text.endswith("x removed")
    alone = score_logs([held], ["mahony"])
    assert any("no bias is removed" in line for line in log_verdict(alone).lines)
    assert "nothing is removed" in write_log_report(tmp_path / "r.html", alone).read_text()


@pytest.mark.parametrize(("bias", "noise"), [(-0.3, 0.0), (0.0, 0.02), (0.3, 0.02)])
def test_no_filter_has_a_larger_error_with_the_estimated_mount(make_flights, bias, noise):
    flight = make_flights(1, 40.0, seed=2, noise=0.0)
    gyro, accel, quat = (flight[name].to_numpy()[0] for name in ("gyro", "accel", "quat"))
    tilted = mount_matrix("rpy 2 0 0")
    shake = quat_from_rotvec(np.random.default_rng(0).normal(0.0, noise, gyro.shape))
    time, accel = np.arange(len(gyro)) / 200.0, accel @ tilted + [0.0, bias, 0.0]
    seen = quat_multiply(quat, shake)
    mine = Recording("mine", "x", time, gyro @ tilted, accel, "mocap", time, seen)
    found = estimate_mount(resample(mine)[0])
    assert found.accel_bias is not None
    uncertain = 0.1 + 2 * 9.81 * np.radians(found.sd_deg[0])
    assert found.levelled or np.abs(found.accel_bias - [0.0, bias]).max() < uncertain
    logs = {"without": mine, "with": mounted(mine, found.body_from_imu)}
    scores = score_logs([resample(replace(each, name=name))[0] for name, each in logs.items()], FILTERS)
    error = scores.on_logs().loc[list(FILTERS)]
    assert (error["with"] < error["without"] + 0.1).all()


def test_a_network_has_the_error_of_itself_silenced_beside_its_own(log):
    scores = score_logs([log], ["att-snn", "mahony"])
    assert scores.mean("att-snn", SILENCED) == pytest.approx(scores.mean(LEVEL, RAW))
    assert np.isnan(scores.mean("mahony", SILENCED))


def test_estimators_that_need_a_vehicle_are_left_out_without_one():
    assert "imm" in default_names()
    assert "ekf-drag" not in default_names()
    assert "ekf-drag" in default_names(vehicle_known=True)


class Given(Level):
    """An estimator that returns what it is made with, or raises it, or is fed the truth."""

    def __init__(self, value):
        super().__init__()
        self.value = value
        if value is None:
            self.observe = self._observe

    def _observe(self, quat):
        self.truth = roll_pitch_from_quat(quat)

    def update(self, gyro, accel):
        if isinstance(self.value, BaseException):
            raise self.value
        return self.truth if self.value is None else np.full((len(gyro), 2), self.value)


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (np.nan, "returned roll or pitch that is not a finite number in 100.0 % of the samples"),
        (None, "receives the true attitude"),
        (KeyError("x"), "did not run: Given ends with KeyError: 'x'"),
    ],
)
def test_what_cannot_be_ranked_is_listed_with_its_reason_and_is_not_the_best(log, tmp_path, value, reason):
    scores = score_logs([log], {"bad": Given(value), "mahony": create("mahony")})
    assert scores.unranked == {"bad": reason}
    assert scores.estimators[-1] == "bad"
    verdict = log_verdict(scores)
    assert "mahony" in verdict.headline
    assert verdict.lines[-1] == f"bad is not ranked: it {reason}."
    assert write_log_report(tmp_path / "r.html", scores).is_file()
    if isinstance(value, BaseException):
        with pytest.raises(ValueError, match="no estimator ran: bad did not run"):
            score_logs([log], {"bad": Given(value)})
    else:
        assert log_verdict(score_logs([log], {"bad": Given(value)})).headline == "No estimator is ranked."


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"gyro": np.nan}, "gyroscope and accelerometer are missing where the attitude is known"),
        ({"scored": False}, "it marks no such sample for scoring"),
        ({"quat": np.nan, "gyro": np.nan}, "it has neither attitude nor readings after the first 3 s"),
        ({"quat": np.nan}, "it has no attitude"),
        ({"quat": quat_from_euler(1.0, 0.0, 0.0)}, "it is tilted by more than 45° all the time (--within)"),
        ({"time": 500}, "nothing is known after the first 3 s, which are not scored"),
        ({"time": 500, "quat": np.nan}, "nothing is known after the first 3 s, which are not scored"),
        ({}, ""),
    ],
)
def test_what_cannot_be_scored_is_said_before_anything_is_run(log, change, reason):
    blank = log.isel(time=slice(change.get("time"))).copy(deep=True)
    for name in change.keys() - {"time"}:
        blank[name][:] = change[name]
    assert prepared(blank).unscorable == reason
    assert prepared(blank, 60.0).unscorable == ("" if "--within" in reason else reason)
    if reason not in ("", "it has no attitude"):
        with pytest.raises(ValueError, match=re.escape(f"mine: nothing to score: {reason}")):
            score_logs([blank], ["mahony"], progress=lambda *_: pytest.fail("something was run"))


def saved(path, log, sensor=1.0, quat=1.0, valid=True):
    """The path of a log as a file, its readings and quaternions times a factor."""
    one = log.isel(flight=0, time=np.isfinite(log["gyro"][0]).all("axis").to_numpy())
    time, gyro, accel, truth = (one[name].to_numpy() for name in ("time", "gyro", "accel", "quat"))
    arrays = {"gyro": sensor * gyro, "acc": sensor * accel, "quat": quat * truth}
    np.savez(path, t=time, valid=np.full(time.size, valid), **arrays)
    return str(path)


EVALUATE = ("evaluate", "--estimator", "mahony", "--out", "out")


def test_evaluate_leaves_a_log_without_attitude_out_and_says_so(log, tmp_path, printed):
    logs = [saved(tmp_path / f"{name}.npz", log, valid=name == "with") for name in ("with", "without")]
    out = printed(*EVALUATE, "--logs", logs[0], "--logs", logs[1])
    assert "warning: without: nothing to score: it has no attitude" in out
    assert "nan" not in out
    assert set(pd.read_csv(tmp_path / "out" / "logs.csv")["log"]) == {"with"}
    out = printed(*EVALUATE, "--logs", logs[1])
    assert "without: rotated to the world and averaged over 10 s" in out
    assert "nan" not in out


def biased_start(bias_deg, seconds=120.0):
    """Readings of a sensor that moves about gently, its gyroscope biased about x [°/s], without a truth."""
    data = noisy(np.radians([bias_deg, 0.0, 0.0]), seconds=seconds)
    data["quat"][:] = np.nan
    return data


def test_a_log_without_truth_is_compared_and_no_estimator_is_crowned(tmp_path):
    log = biased_start(3.0)
    good, bad = create("mahony", k_p=1.0, k_i=0.3), create("mahony", k_p=0.4, k_i=0.0)
    scores = score_logs([log], {"with bias": bad, "without": good, "same": good, "broken": Given(np.nan)})
    found = scores.compared["noisy"]
    assert found.favoured == ("without", "same")
    assert found.force["with bias"] > 5 * found.force["without"]
    assert found.force["without"] < 0.15
    median, most = found.apart["with bias", "without"]
    assert 5.0 < median < 9.0
    assert most >= median
    assert found.apart["without", "same"] == (0.0, 0.0)
    assert "not a finite number" in found.flaws["broken"]
    verdict = log_verdict(scores)
    assert verdict.headline == (
        "The log has no true attitude, so no errors are given; the mean force favours without, same."
    )
    assert any("It is near zero for a correct attitude" in line for line in verdict.lines)
    assert "horizontal force" in write_log_report(tmp_path / "r.html", scores).read_text()


def test_a_constant_is_not_compared_however_small_its_force_is():
    """On a vehicle that stays level on the whole a level guess has a small force."""
    made = {"zero": Given(0.0), "mahony": create("mahony"), "slow": create("mahony", k_p=0.01, k_i=0.0)}
    scores = score_logs([biased_start(0.0)], made)
    found = scores.compared["noisy"]
    assert "the same roll and pitch" in found.flaws["zero"]
    assert "zero" not in found.force
    assert f"{found.level_force:.2f} m/s² for a level guess" in " ".join(log_verdict(scores).lines)


def test_a_force_as_small_as_that_of_a_level_guess_favours_nobody():
    level = np.zeros((200 * 60, 2))
    gyro, accel = np.zeros((len(level), 3)), np.tile([0.0, 0.0, GRAVITY], (len(level), 1))
    found = compare({"right": level, "wrong": level + 0.2}, gyro, accel, 200.0, {})
    assert found.force["wrong"] > 1.0
    assert (found.favoured, found.undecided) == ((), "the force of a level guess is not significantly larger")
    tilted = np.tile([GRAVITY * np.sin(0.2), 0.0, GRAVITY * np.cos(0.2)], (len(level), 1))
    right = np.tile([0.0, -0.2], (len(level), 1))
    found = compare({"right": right, "wrong": -right}, gyro, tilted, 200.0, {})
    assert (found.favoured, found.undecided) == (("right",), "")


def test_a_short_log_decides_nothing_and_says_so():
    scores = score_logs([biased_start(3.0, 30.0)], {"mahony": create("mahony"), "vqf": create("vqf")})
    said = "the evidence favours no estimator: the log is shorter than 40 s."
    assert log_verdict(scores).headline.endswith(said)


def test_forces_that_all_estimators_share_favour_none():
    made = {name: create("mahony", k_p=1.0, k_i=0.0) for name in "ab"}
    scores = score_logs([biased_start(0.0, 60.0)], made)
    assert scores.compared["noisy"].favoured == ()
    assert "the evidence favours no estimator: " in log_verdict(scores).headline


def test_what_imm_believes_of_a_log_without_truth_has_its_sigma(tmp_path):
    log = biased_start(0.0, 20.0)
    scores = score_logs([log], {"imm": create("imm")})
    said = " ".join(log_verdict(scores).lines)
    assert re.search(r"Mean model probabilities of imm.*its σ is \d+\.\d° in the median", said)
    assert "sigma|imm, roll" in write_log_report(tmp_path / "r.html", scores).read_text()


def test_forces_in_a_steady_turn_do_not_add_up():
    time = np.arange(12_000) / 200.0
    bank = np.tile([0.2, 0.0], (12_000, 1))
    up = np.array([0.0, np.sin(0.2), np.cos(0.2)])
    gyro, accel = np.tile(1.0 * up, (12_000, 1)), np.tile([0.0, 0.0, 9.81 / np.cos(0.2)], (12_000, 1))
    force = horizontal_force(bank, gyro, accel, 200.0)
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), 9.81 * np.tan(0.2), rtol=1e-9)
    turned = np.unwrap(np.arctan2(force[:, 1], force[:, 0]))
    np.testing.assert_allclose(turned - turned[0], time, atol=1e-6)


@pytest.mark.filterwarnings("error")
def test_numbers_that_no_sensor_has_are_refused_without_numpy_s_warnings(log, tmp_path, refused):
    for name, sensor, quat in (("readings", 1e300, 1.0), ("truth", 1.0, 1e200)):
        path = saved(tmp_path / f"{name}.npz", log, sensor, quat)
        assert name in refused(*EVALUATE, "--logs", path)


def test_vqf_has_its_published_error_on_a_real_recording(broad):
    tenth = next(path for path in broad if path.name.startswith("10_"))
    scores = score_logs([read_log(tenth)], ["vqf"])
    assert scores.mean("vqf", RAW) < 0.5
    assert scores.mean(LEVEL, RAW) > 5.0
