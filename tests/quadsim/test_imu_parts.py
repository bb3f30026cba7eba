"""Parts of an IMU's error, each alone: its equation, and that it can be switched off."""

import numpy as np
import pytest
from imu_errors import EVERYTHING, PARTS, RATE, at_rest, flight, only, without
from scipy import signal
from sensor import body_rate

from quadsim.imu.spec import ImuSpec, RotorVibration, Sensor, load_imu
from quadsim.imu.stream import BLOCK, simulate_imu
from quadsim.rotation import quat_from_euler, quat_rotate, quat_rotate_inverse


@pytest.mark.parametrize("part", ["noise", "random_walk", "turn_on", "vibration", "g_sensitivity"])
def test_a_part_has_the_same_random_numbers_alone_and_among_others(part):
    motion, others = flight(2, BLOCK + 20), {"noise", "random_walk", "turn_on"} - {part}
    among = simulate_imu(only(EVERYTHING, part, *others), **motion, rate_hz=RATE, seed=3)
    others_alone = simulate_imu(only(EVERYTHING, *others), **motion, rate_hz=RATE, seed=3)
    alone = simulate_imu(only(EVERYTHING, part), **motion, rate_hz=RATE, seed=3)
    truth = simulate_imu(without(EVERYTHING, *PARTS), **motion, rate_hz=RATE, seed=3)
    for sensor in range(2):
        assert among[sensor] - others_alone[sensor] == pytest.approx(alone[sensor] - truth[sensor], abs=1e-12)


def test_the_same_samples_are_dropped_whatever_else_is_on():
    motion, held = flight(2, BLOCK + 20), []
    for others in ([], ["noise", "turn_on", "vibration"]):
        gyro, _ = simulate_imu(only(EVERYTHING, "dropped", *others), **motion, rate_hz=RATE, seed=3)
        held.append(np.diff(gyro, axis=1) == 0.0)
    assert np.array_equal(*held)
    assert held[0].any()


@pytest.mark.parametrize("part", sorted(PARTS))
def test_every_part_changes_the_reading_and_can_be_switched_off(part):
    motion = flight(1, 150)
    motion["ang_vel"] = 40.0 * motion["ang_vel"]  # beyond the range, to saturate
    truth = simulate_imu(load_imu("perfect"), **motion, rate_hz=RATE, seed=3)
    alone = simulate_imu(only(EVERYTHING, part), **motion, rate_hz=RATE, seed=3)
    assert not np.array_equal(alone, truth)
    assert np.array_equal(simulate_imu(without(EVERYTHING, *PARTS), **motion, rate_hz=RATE, seed=3), truth)


def test_lever_arm_agrees_with_the_motion_of_the_point():
    arm, dt = np.array([0.12, -0.05, 0.3]), 1e-4
    t = np.arange(-3, 4) * dt + 0.7
    roll, pitch, yaw = 0.8 * np.sin(3.0 * t), 0.5 * np.cos(2.0 * t), 1.5 * t
    quat = quat_from_euler(roll, pitch, yaw)
    point = quat_rotate(quat, arm)
    rates = (np.gradient(each, dt) for each in (roll, pitch, yaw))
    ang_vel = body_rate(roll, pitch, *rates)[2:5]
    ang_acc = (ang_vel[2] - ang_vel[0]) / (2.0 * dt)
    acceleration = (point[4] - 2.0 * point[3] + point[2]) / dt**2
    expected = quat_rotate_inverse(quat[3], acceleration)
    spec = ImuSpec(lever_arm=tuple(arm))
    _, accel = simulate_imu(
        spec, ang_vel[1][None, None], np.zeros((1, 1, 3)), RATE, seed=0, ang_acc=ang_acc[None, None]
    )
    assert accel[0, 0] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("rate_hz", [50.0, 200.0, 1000.0])
def test_low_pass_delays_a_ramp_by_its_closed_form_at_any_rate(rate_hz):
    sensor = Sensor(low_pass_hz=30.0)
    time = np.arange(400) / rate_hz
    ramp = np.repeat(4.0 * time[None, :, None], 3, axis=2)
    gyro, accel = simulate_imu(ImuSpec(gyro=sensor, accel=sensor), ramp, ramp + 1.0, rate_hz, seed=0)
    delay = np.sqrt(2.0) / (2.0 * np.pi * 30.0)
    settled = int(0.3 * rate_hz)
    assert gyro[:, settled:] == pytest.approx(ramp[:, settled:] - 4.0 * delay, abs=1e-9)
    assert accel[:, settled:] == pytest.approx(gyro[:, settled:] + 1.0, abs=1e-9)


def test_low_pass_has_the_butterworth_response():
    sensor, rate_hz = Sensor(low_pass_hz=30.0), 8000.0
    time = np.arange(8000) / rate_hz
    for frequency in (10.0, 30.0, 90.0):
        wave = np.repeat(np.sin(2.0 * np.pi * frequency * time)[None, :, None], 3, axis=2)
        gyro, _ = simulate_imu(ImuSpec(gyro=sensor), wave, wave, rate_hz, seed=0)
        _, response = signal.freqs(
            *signal.butter(2, 2.0 * np.pi * 30.0, analog=True), 2.0 * np.pi * frequency
        )
        expected = np.abs(response) * np.sin(2.0 * np.pi * frequency * time + np.angle(response))
        assert gyro[0, 4000:, 1] == pytest.approx(expected[4000:], abs=2e-3)


def test_low_pass_starts_settled():
    spec = ImuSpec(accel=Sensor(low_pass_hz=5.0))
    _, accel = simulate_imu(spec, **at_rest(1, 50), rate_hz=RATE, seed=0)
    assert accel == pytest.approx(at_rest(1, 50)["specific_force"], abs=1e-13)


def test_readings_are_multiples_of_the_resolution():
    spec = ImuSpec(gyro=Sensor(resolution=0.25, saturation=1.3), accel=Sensor(resolution=0.5))
    ang_vel = np.array([[[0.1, 0.13, -0.12], [-0.13, 1.2, 9.0], [-9.0, 1.12, -1.2]]])
    gyro, accel = simulate_imu(spec, ang_vel, 10.0 * ang_vel, RATE, seed=0)
    assert gyro.tolist() == [[[0.0, 0.25, 0.0], [-0.25, 1.25, 1.25], [-1.25, 1.0, -1.25]]]
    assert accel.tolist() == [[[1.0, 1.5, -1.0], [-1.5, 12.0, 90.0], [-90.0, 11.0, -12.0]]]


def test_scale_factor_and_misalignment_have_their_spread():
    sensor = Sensor(scale_factor=0.01, misalignment=0.02)
    truth = np.broadcast_to([1.0, 0.0, 0.0], (1000, 2, 3))
    gyro, accel = simulate_imu(ImuSpec(gyro=sensor, accel=sensor), truth, truth, RATE, seed=0)
    for reading in (gyro, accel):
        error = reading - truth
        assert np.array_equal(error[:, 0], error[:, 1])
        assert error[:, 0, 0].std() == pytest.approx(0.01, rel=0.07)
        assert error[:, 0, 1:].std() == pytest.approx(0.02, rel=0.05)


def test_a_turned_sensor_reads_what_one_along_the_body_reads_of_the_turned_motion():
    angles = (20.0, -40.0, 110.0)
    along = without(EVERYTHING, "mounting_deg", "lever_arm", "vibration", "resolution")
    turned = along.model_copy(update={"mounting_deg": angles})
    motion, quat = flight(3, 50), quat_from_euler(*np.radians(angles))
    rate, force = motion["ang_vel"], motion["specific_force"]
    readings = simulate_imu(turned, rate, force, RATE, seed=5)
    in_sensor_axes = (quat_rotate_inverse(quat, each) for each in (rate, force))
    expected = simulate_imu(along, *in_sensor_axes, RATE, seed=5)
    np.testing.assert_allclose(readings, expected, atol=1e-12)


def test_gyro_error_by_force_is_proportional_and_has_its_spread():
    spec = ImuSpec(g_sensitivity=1e-3)
    forces = np.broadcast_to(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]]), (500, 2, 3))
    gyro, accel = simulate_imu(spec, np.zeros((500, 2, 3)), forces, RATE, seed=0)
    assert gyro[:, 1] == pytest.approx(2.0 * gyro[:, 0])
    assert gyro[:, 0].std() == pytest.approx(1e-3, rel=0.06)
    assert np.array_equal(accel, forces)


def vibrating(speeds, rate_hz: float = 1000.0, low_pass_hz: float = 0.0, shape=(1, 20_000), **amplitudes):
    """What rotors of these speeds shake, both sensors (n, T, 3)."""
    spec = ImuSpec(
        accel=Sensor(low_pass_hz=low_pass_hz), vibration=RotorVibration(rotor_vel=400.0, **amplitudes)
    )
    still, rotor_vel = np.zeros((*shape, 3)), np.broadcast_to(speeds, (*shape, 4))
    return simulate_imu(spec, still, still, rate_hz, seed=0, rotor_vel=rotor_vel)


@pytest.mark.parametrize(("rate_hz", "seen_hz"), [(1000.0, 70.0), (200.0, 70.0), (100.0, 30.0)])
def test_vibration_appears_at_the_rotor_frequency_or_at_its_alias(rate_hz, seen_hz):
    gyro, accel = vibrating([0.0, 2.0 * np.pi * 70.0, 0.0, 0.0], rate_hz, accel=(0.5, 0.0, 0.0))
    frequency, density = signal.periodogram(accel[0, :, 0], rate_hz)
    assert frequency[np.argmax(density)] == pytest.approx(seen_hz, abs=0.3)
    assert not gyro.any()
    assert not accel[..., 1:].any()


def test_vibration_grows_with_the_square_of_the_speed_and_falls_behind_the_low_pass():
    def rms(speed: float, low_pass_hz: float = 0.0) -> float:
        return vibrating([0.0, speed, 0.0, 0.0], 1000.0, low_pass_hz, accel=(0.5, 0.0, 0.0))[1][..., 0].std()

    assert np.sqrt(2.0) * rms(400.0) == pytest.approx(0.5, rel=1e-2)
    assert np.sqrt(2.0) * rms(800.0) == pytest.approx(2.0, rel=1e-2)
    assert rms(400.0, 200.0 / np.pi) == pytest.approx(rms(400.0) / np.sqrt(2.0), rel=1e-2)  # at the corner


def test_vibration_of_all_rotors_has_its_root_mean_square_on_every_axis_of_both_sensors():
    gyro, accel, speeds = (0.03, 0.02, 0.01), (1.0, 2.0, 3.0), np.array([380.0, 400.0, 420.0, 440.0])
    mean_square = np.sum((speeds / 400.0) ** 4) / 2.0  # of a unit amplitude
    for reading, amplitude in zip(vibrating(speeds, gyro=gyro, accel=accel), (gyro, accel), strict=True):
        rms = np.sqrt(np.mean(reading[0] ** 2, axis=0))
        assert rms == pytest.approx(np.array(amplitude) * np.sqrt(mean_square), rel=2e-3)


def test_rotors_of_one_speed_shake_with_phases_of_their_own():
    _, accel = vibrating([400.0] * 4, shape=(3000, 2), accel=(1.0, 1.0, 1.0))
    assert np.mean(accel[:, 0] ** 2) == pytest.approx(4 * 0.5, rel=0.05)  # 16 * 0.5 if they shook as one


def test_dropped_samples_repeat_the_reading_before():
    spec, motion = ImuSpec(dropped=0.2), flight(2, 5000)
    gyro, accel = simulate_imu(spec, motion["ang_vel"], motion["specific_force"], RATE, seed=0)
    lost = np.any(gyro != motion["ang_vel"], axis=-1)
    assert not lost[:, 0].any()
    assert lost.mean() == pytest.approx(0.2, abs=0.015)
    assert np.array_equal(lost, np.any(accel != motion["specific_force"], axis=-1))
    late = lost[:, 1:]
    assert np.array_equal(gyro[:, 1:][late], gyro[:, :-1][late])
