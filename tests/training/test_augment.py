import numpy as np
import pytest

from quadsim.imu.spec import ImuSpec, Sensor
from training.augment import measured, turned_and_mirrored
from training.circuit.imus import draw_imu
from training.circuit.streams import interrupt
from training.config import CircuitTraining, make_config
from training.data import load_training_flights


def test_symmetry_keeps_kinematics_and_gravity(dataset):
    flights = load_training_flights([dataset])
    rng = np.random.default_rng(0)
    rate, force, up = (getattr(flights, k).astype(float) for k in ("ang_vel", "specific_force", "up"))
    gyro, accel, turned = turned_and_mirrored(rate, force, up, rng)
    np.testing.assert_allclose((accel * turned).sum(-1), (force * up).sum(-1), atol=1e-5)
    # d up / dt = up x rate, in the turned axes as in the old ones.
    slope = (turned[:, 2:] - turned[:, :-2]) * 100.0
    residual = slope - np.cross(turned, gyro)[:, 1:-1]
    assert np.abs(residual).max() < 0.1 * np.abs(slope).max()
    assert not np.allclose(turned, up)


def test_half_of_the_streams_are_mirrored():
    """A mirror image turns the other way about z."""
    spin = np.tile([0.0, 0.0, 1.0], (400, 2, 1))
    gyro, _, up = turned_and_mirrored(spin, spin, spin, np.random.default_rng(0))
    assert 0.4 < (gyro[:, 0, 2] < 0).mean() < 0.6
    np.testing.assert_allclose(up[..., 2], 1)


def test_every_stream_has_an_imu_of_its_own_and_the_type_of_the_truth():
    zero = np.zeros((2, 400, 3), np.float32)
    imus = [ImuSpec(), ImuSpec(gyro=Sensor(noise=0.01), accel=Sensor(turn_on=1.0))]
    gyro, accel = measured(imus, zero, zero, 200.0, np.random.default_rng(0))
    assert gyro.dtype == np.float32
    assert not gyro[0].any()
    assert not accel[0].any()
    assert gyro[1].std() == pytest.approx(0.01 * np.sqrt(200), rel=0.1)
    assert np.ptp(accel[1], axis=0).max() == 0
    assert np.abs(accel[1]).max() > 0.1
    with pytest.raises(ValueError, match="2 IMUs for 3 vehicles"):
        measured(imus, np.zeros((3, 4, 3)), np.zeros((3, 4, 3)), 200.0, np.random.default_rng(0))


def test_a_vibrating_imu_is_shaken_behind_its_low_pass():
    still = np.zeros((1, 4000, 3))
    worst = make_config("att-snn", data="x").imu
    only = ImuSpec(vibration=worst.vibration)
    filtered = only.model_copy(update={"accel": Sensor(low_pass_hz=15.0)})
    sizes = [
        measured(spec, still, still, 200.0, np.random.default_rng(0))[1].std() for spec in (only, filtered)
    ]
    assert sizes[0] > 1
    assert sizes[1] < 0.1 * sizes[0]


def test_no_imu_is_worse_than_the_worst_and_calibrated_ones_have_the_least_errors():
    worst, rng = make_config("att-snn", data="x").imu, np.random.default_rng(0)
    imus = [draw_imu(worst, False, rng) for _ in range(300)]
    assert all(0.2 <= imu.gyro.turn_on / worst.gyro.turn_on <= 1 for imu in imus)
    assert all(worst.accel.noise / 6.01 < imu.accel.noise <= worst.accel.noise for imu in imus)
    assert all(15 <= imu.gyro.low_pass_hz == imu.accel.low_pass_hz <= 90 for imu in imus)
    assert all(np.abs(imu.mounting_deg).max() <= 4 for imu in imus)
    saturated = [imu.gyro.saturation for imu in imus if imu.gyro.saturation]
    assert 0.1 < len(saturated) / 300 < 0.2
    assert 1 <= min(saturated) < max(saturated) <= 30
    for share, found in (
        (0.5, [imu.vibration is not None for imu in imus]),
        (0.5, [any(imu.lever_arm) for imu in imus]),
        (0.2, [imu.dropped > 0 for imu in imus]),
    ):
        assert np.mean(found) == pytest.approx(share, abs=0.1)
    calibrated = [draw_imu(worst, True, rng) for _ in range(300)]
    assert {imu.gyro.turn_on for imu in calibrated} == {0.2 * worst.gyro.turn_on}
    assert max(np.abs(imu.mounting_deg).max() for imu in calibrated) <= 0.8
    assert draw_imu(ImuSpec(), False, rng) == ImuSpec()


def test_interrupted_streams_repeat_a_sample_and_have_false_rates():
    rng = np.random.default_rng(0)
    readings = (rng.normal(size=(400, 400, 3)), rng.normal(size=(400, 400, 3)))
    interrupt(readings, CircuitTraining().interrupted_share, 200.0, rng)
    repeated = (np.diff(readings[1], axis=1) == 0).all(2).sum(1)
    assert 0.08 < (repeated > 0).mean() < 0.22
    assert 80 < repeated.max() < 100
    false = np.abs(readings[0]) > 8
    assert 0 < false.any(2).sum(1).max() <= 10
    assert false.any(1).sum(1).max() == 1
