import numpy as np
import pytest

from quadsim.imu import simulate_imu
from quadsim.imu.spec import ImuSpec
from training.augment import Augmentation, augment
from training.data import load_training_flights


def only(**errors):
    """These errors, and none of those that are there by default."""
    return Augmentation(**{"gyro_noise": 0, "accel_noise": 0, "accel_bias": 0} | errors)


def test_symmetry_keeps_kinematics_and_gravity(dataset):
    flights = load_training_flights([dataset])
    rng = np.random.default_rng(0)
    rate, force, up = (getattr(flights, k).astype(float) for k in ("ang_vel", "specific_force", "up"))
    gyro, accel, turned = augment(rate, force, up, only(yaw_symmetry=True), 200.0, rng)
    np.testing.assert_allclose((accel * turned).sum(-1), (force * up).sum(-1), atol=1e-5)
    # d up / dt = up x rate, in the turned axes as in the old ones.
    slope = (turned[:, 2:] - turned[:, :-2]) * 100.0
    residual = slope - np.cross(turned, gyro)[:, 1:-1]
    assert np.abs(residual).max() < 0.1 * np.abs(slope).max()
    assert not np.allclose(turned, up)


def test_noise_has_the_density_that_is_asked_for():
    zero = np.zeros((20, 2000, 3), np.float32)
    both = Augmentation(gyro_noise=0.01, accel_noise=0.02, gyro_bias=0.1, accel_bias=0.3)
    gyro, accel, _ = augment(zero, zero, zero, both, 200.0, np.random.default_rng(0))
    for signal, density, bias in ((gyro, 0.01, 0.1), (accel, 0.02, 0.3)):
        np.testing.assert_allclose(signal.std(1).mean(), density * np.sqrt(200), rtol=0.02)
        np.testing.assert_allclose(signal.mean(1).std(), bias, rtol=0.3)


def test_an_imu_off_the_centre_feels_what_the_simulators_imu_feels():
    """Spins about z and x tell the arm; then any rate that grows evenly, ω̇ × r + ω × (ω × r)."""
    displaced = only(lever_arm_max=0.1)

    def felt(rate):
        rates = np.broadcast_to(rate, (200, 20, 3))
        return augment(rates, 0 * rates, 0 * rates, displaced, 200.0, np.random.default_rng(1))[1]

    about_z, about_x = (felt(spin)[:, 0] / -(4.0**2) for spin in ([0.0, 0.0, 4.0], [4.0, 0.0, 0.0]))
    arms = np.column_stack([about_z[:, :2], about_x[:, 2]])
    assert 0.3 < arms.any(1).mean() < 0.7
    assert 0.09 < np.abs(arms).max() < 0.1
    turn = np.array([30.0, -20.0, 50.0])
    rate = np.array([1.0, 2.0, -3.0]) + turn * np.arange(20)[:, None] / 200.0
    for arm, accel in zip(arms[:6], felt(rate), strict=False):
        spec, ang_acc = ImuSpec(lever_arm=tuple(arm)), np.broadcast_to(turn, (1, 20, 3))
        _, expected = simulate_imu(spec, rate[None], 0 * rate[None], 200.0, seed=0, ang_acc=ang_acc)
        np.testing.assert_allclose(accel[1:], expected[0, 1:], atol=1e-12)


def test_vibration_has_its_size_in_the_accelerometer_and_a_hundredth_in_the_gyroscope():
    """Two tones a sin + b cos, a and b uniform within ± size / 2: a root mean square of size / √6."""
    zero = np.zeros((2000, 100, 3), np.float32)
    vibration = only(vibration=(6.0, 6.0), vibration_share=1.0)
    gyro, accel, _ = augment(zero, zero, zero, vibration, 200.0, np.random.default_rng(0))
    for signal, size in ((accel, 6.0), (gyro, 0.06)):
        rms = np.sqrt(np.mean(signal.astype(float) ** 2, axis=(0, 1)))
        np.testing.assert_allclose(rms, size / np.sqrt(6), rtol=0.05)


def test_lost_samples_are_missing_in_both_sensors_at_their_share():
    zero = np.zeros((400, 500, 3), np.float32)
    lossy = Augmentation(drop_share=0.5, drop_max=0.2)
    gyro, accel, up = augment(zero, zero, zero, lossy, 200.0, np.random.default_rng(0))
    np.testing.assert_array_equal(np.isnan(gyro), np.isnan(accel))
    lost = np.isnan(gyro).all(2).mean(1)
    assert 0.4 < (lost > 0).mean() < 0.6
    assert lost.max() < 0.26
    assert lost[lost > 0].mean() == pytest.approx(0.1, abs=0.02)
    assert not np.isnan(up).any()


def test_rough_sensors_are_drawn_within_their_limits():
    rng, n, steps = np.random.default_rng(0), 400, 400
    still, force = np.zeros((n, steps, 3), np.float32), np.zeros((n, steps, 3), np.float32)
    force[..., 2] = 9.81
    up = force / np.float32(9.81)
    gyro, accel, _ = augment(still, force, up, only(gyro_bias_max=0.1), 200.0, rng)
    assert 0.08 < np.abs(gyro).max() <= 0.1
    assert np.ptp(gyro, axis=1).max() == 0
    np.testing.assert_array_equal(accel, force)
    _, accel, _ = augment(still, force, up, only(mounting_max_deg=5.0), 200.0, rng)
    tilt = np.degrees(np.arccos(accel[:, 0, 2] / 9.81))
    assert 3.0 < tilt.max() < 7.1  # roll and pitch of at most 5° each
    vibrating = only(vibration=(1.0, 2.0), vibration_share=0.5)
    _, accel, _ = augment(still, force, up, vibrating, 200.0, rng)
    spread = accel.std(axis=1).max(axis=1)
    assert 0.4 < (spread > 0.05).mean() < 0.6
    assert spread.max() < 2.0


def test_readings_are_low_passed_and_delayed():
    rng = np.random.default_rng(0)
    step = np.zeros((200, 400, 3), np.float32)
    step[:, 200:] = 1.0
    gyro, _, _ = augment(step, step, step, only(delay_max_s=0.02), 200.0, rng)
    assert set(np.argmax(gyro[..., 0] > 0.5, axis=1)) == {200, 201, 202, 203, 204}
    gyro, _, _ = augment(step, step, step, only(low_pass_hz=(10.0, 10.0)), 200.0, rng)
    assert gyro[0, 200 + 3, 0] == pytest.approx(1 - np.exp(-2 * np.pi * 10 * 4 / 200), abs=1e-3)
