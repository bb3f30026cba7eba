"""The estimator imm with rotor speeds: they remove the harm of vibration, and may be missing."""

import numpy as np
import pytest
from imm_flights import RATE, VARIED, imm, rmse
from small_dataset import generated

from estimators import run, run_batch
from estimators.evaluation.comparison import evaluate
from estimators.evaluation.flights import load_flights
from estimators.evaluation.logs import score_logs
from estimators.metrics import absolute_error
from quadsim.imu.spec import RotorVibration
from quadsim.logs.recording import Recording, Track
from quadsim.logs.resample import resample


@pytest.fixture(scope="module")
def shaken_data(tmp_path_factory):
    """A dataset of four flights with strong rotor vibration."""
    vibration = RotorVibration(rotor_vel=453.0, gyro=(0.05, 0.05, 0.02), accel=(2.0, 2.0, 5.0))
    config = VARIED.model_copy(update={"imu": VARIED.imu.model_copy(update={"vibration": vibration})})
    return generated(tmp_path_factory.mktemp("shaken"), config, 4, 30.0, seed=72)


@pytest.fixture(scope="module")
def shaken(shaken_data):
    return load_flights([shaken_data])


def test_rotor_speeds_remove_the_harm_of_vibration(shaken):
    """Vibration along body z biases the root of thrust; the rotors' speeds do not have it."""
    rotors = shaken.readings.rotor_vel
    without = rmse(imm(), shaken.gyro, shaken.accel, shaken.truth)
    assert rmse(imm(), shaken.gyro, shaken.accel, shaken.truth, rotor_vel=rotors) < 0.95 * without


def test_only_ratios_of_rotor_speeds_count(shaken):
    """The thrust constant is not known, nor is the direction in which a rotor turns."""
    given = [run(imm(), shaken.gyro, shaken.accel, rotor_vel=k * shaken.readings.rotor_vel) for k in (1, -4)]
    np.testing.assert_array_equal(*given)


@pytest.mark.parametrize("value", [0.0, 0.1, np.nan, np.inf, 1e6])
def test_rotor_speeds_that_cannot_be_used_change_nothing(shaken, value):
    """Missing, stopped, or no number: of one rotor or, of a speed that could be, of all."""
    rotors = shaken.readings.rotor_vel.copy()
    rotors[..., 0 if not abs(value) < 1.0 else slice(None)] = value
    without = run(imm(), shaken.gyro, shaken.accel)
    np.testing.assert_array_equal(run(imm(), shaken.gyro, shaken.accel, rotor_vel=rotors), without)


def test_rotor_speeds_may_come_and_go(shaken):
    """Until the first one the numbers are those without; a second without them does no lasting harm."""
    gyro, accel, truth = shaken.gyro, shaken.accel, shaken.truth
    late, gap = shaken.readings.rotor_vel.copy(), shaken.readings.rotor_vel.copy()
    late[:, :3000], gap[:, 3000:3200] = np.nan, np.nan
    estimate, without = run(imm(), gyro, accel, rotor_vel=late), run(imm(), gyro, accel)
    np.testing.assert_array_equal(estimate[:, :3000], without[:, :3000])
    assert np.abs(estimate[:, 3010:] - without[:, 3010:]).max() > 1e-3
    always = rmse(imm(), gyro, accel, truth, rotor_vel=shaken.readings.rotor_vel)
    assert rmse(imm(), gyro, accel, truth, rotor_vel=gap) == pytest.approx(always, rel=0.05)


def test_a_rotor_speed_that_is_stuck_does_no_harm(shaken):
    rotors = np.full_like(shaken.readings.rotor_vel, 400.0)
    without = rmse(imm(), shaken.gyro, shaken.accel, shaken.truth)
    assert rmse(imm(), shaken.gyro, shaken.accel, shaken.truth, rotor_vel=rotors) < 1.05 * without


def test_rotor_speeds_stream_as_they_run_and_as_they_run_in_a_batch(shaken):
    part = shaken.map(lambda each: np.ascontiguousarray(each[:2, :600]))
    rotors = part.readings.rotor_vel
    est = imm()
    at_once = run(est, part.gyro, part.accel, rotor_vel=rotors)
    est.reset(2)
    for t in range(600):
        now = est.update(part.gyro[:, t], part.accel[:, t], rotor_vel=rotors[:, t])
        np.testing.assert_array_equal(now, at_once[:, t])
    sets = {name: [value] * 2 for name, value in est.values.items()}
    batch = run_batch("imm", sets, part.gyro, part.accel, rotor_vel=rotors)
    np.testing.assert_array_equal(batch, np.stack([at_once] * 2))


@pytest.mark.parametrize("rotors", [np.ones((1, 4)), np.ones(4), np.ones((2, 1, 4)), np.ones((3, 4))])
def test_rotor_speeds_of_another_shape_are_refused(rotors):
    est = imm()
    est.reset(2)
    with pytest.raises(ValueError, match=r"rotor_vel has shape .* it must be \(2, ·\)"):
        est.update(np.zeros((2, 3)), np.ones((2, 3)), rotor_vel=rotors)
    with pytest.raises(ValueError, match="rotor_vel has shape"):
        est.sequence(np.zeros((2, 5, 3)), np.ones((2, 5, 3)), rotor_vel=rotors)


def test_evaluate_gives_imm_the_rotor_speeds_of_a_dataset(shaken_data, shaken):
    given = run(imm(), shaken.gyro, shaken.accel, rotor_vel=shaken.readings.rotor_vel)
    row = evaluate(shaken_data, {"imm": imm()}, initial=("unknown",), settle_s=5.0).rows[0]
    assert row.mean_deg == pytest.approx(absolute_error(given, shaken.truth).mean(), rel=1e-9)


def test_evaluate_gives_imm_the_rotor_speeds_of_a_log(shaken):
    time, quat = np.arange(shaken.gyro.shape[1]) / RATE, shaken.quat[0]
    speeds = {"rotor_vel": Track(time, shaken.readings.rotor_vel[0])}
    readings = time, shaken.gyro[0], shaken.accel[0], "x", time, quat
    log = resample(Recording("mine", "x", *readings, sensors=speeds), RATE)[0]
    gyro, accel, rotors = (log[name].to_numpy() for name in ("gyro", "accel", "rotor_vel"))
    scores = score_logs([log], {"imm": imm()})
    given = run(imm(), gyro, accel, rotor_vel=rotors)[0]
    np.testing.assert_array_equal(scores.logs["mine"].estimates["imm"], given)
    assert np.abs(given - run(imm(), gyro, accel)[0]).max() > 1e-3
    believed = scores.logs["mine"].beliefs["imm"]
    np.testing.assert_array_equal(believed.roll_pitch[0], given[believed.samples])
