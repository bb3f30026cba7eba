import allantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from quadsim.config.toml import preset_names
from quadsim.imu.spec import ImuSpec, RotorVibration, Sensor, load_imu
from quadsim.imu.stream import BLOCK, ImuStream, motion_of, simulate_imu, simulate_readings
from quadsim.rotation import quat_from_euler, quat_rotate, quat_rotate_inverse

RATE = 200.0
ADIS = load_imu("adis16448")
EVERYTHING = load_imu("px4-mini").model_copy(
    update={
        "lever_arm": (0.03, -0.01, 0.02),
        "mounting_deg": (5.0, -10.0, 90.0),
        "vibration": RotorVibration(rotor_vel=450.0, gyro=(0.02, 0.02, 0.01), accel=(1.0, 1.0, 2.0)),
        "dropped": 0.05,
    }
)


PARTS = (set(ImuSpec.model_fields) | set(Sensor.model_fields)) - {
    *("gyro", "accel", "time_constant", "low_pass_order"),
}
"""Parts of the error that can be switched off, by the name of their field."""


def without(spec, *parts):
    """The same IMU, or sensor, with some parts of its error off."""
    fields = type(spec).model_fields
    update = {part: fields[part].default for part in parts if part in fields}
    if isinstance(spec, ImuSpec):
        update |= {name: without(getattr(spec, name), *parts) for name in ("gyro", "accel")}
    return spec.model_copy(update=update)


def only(spec, *parts):
    """The same IMU with only some parts of its error."""
    return without(spec, *PARTS.difference(parts))


def flight(n: int, steps: int) -> dict[str, np.ndarray]:
    """Some motion, the same for a vehicle in any batch."""
    time = np.arange(steps) / RATE
    phase = np.arange(n)[:, None, None] + np.arange(3)
    swing = np.sin(2.0 * np.pi * 1.3 * time[None, :, None] + phase)
    turn = np.cos(2.0 * np.pi * 1.3 * time[None, :, None] + phase)
    return {
        "ang_vel": 2.0 * swing,
        "specific_force": 3.0 * turn + [0.0, 0.0, 9.81],
        "ang_acc": 2.0 * np.pi * 2.6 * turn,
        "rotor_vel": 450.0 + 50.0 * swing[..., [0, 1, 2, 0]],
    }


def at_rest(n: int, steps: int) -> dict[str, np.ndarray]:
    force = np.broadcast_to([0.0, 0.0, 9.81], (n, steps, 3))
    return {"ang_vel": np.zeros((n, steps, 3)), "specific_force": force}


def with_bias(spec: ImuSpec, motion: dict[str, np.ndarray], rate_hz: float, seed: int):
    """Readings of the gyroscope and the accelerometer, and their true biases."""
    return simulate_readings(spec, motion_of(spec, **motion), rate_hz, seed).values()


def stream_through(stream: ImuStream, motion: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    steps = motion["ang_vel"].shape[1]
    readings = [
        stream.sample(**{name: series[:, t] for name, series in motion.items()}) for t in range(steps)
    ]
    gyro, accel = zip(*readings, strict=True)
    return np.stack(gyro, axis=1), np.stack(accel, axis=1)


# --- the interface --------------------------------------------------------------------------------


def test_perfect_imu_reads_the_truth():
    motion = flight(3, 50)
    gyro, accel = simulate_imu(load_imu("perfect"), motion["ang_vel"], motion["specific_force"], RATE, seed=0)
    assert np.array_equal(gyro, motion["ang_vel"])
    assert np.array_equal(accel, motion["specific_force"])


@pytest.mark.parametrize("spec", [EVERYTHING, ADIS], ids=["everything", "adis16448"])
def test_streaming_and_whole_arrays_give_the_same_numbers(spec):
    motion = flight(3, 2 * BLOCK + 37)
    stream = ImuStream(spec, 3, RATE, seed=5)
    gyro, accel, gyro_bias, accel_bias = with_bias(spec, motion, RATE, 5)
    assert np.array_equal(stream_through(stream, motion), (gyro, accel))
    assert np.array_equal(stream.biases["gyro"], gyro_bias[:, -1])
    assert np.array_equal(stream.biases["accel"], accel_bias[:, -1])


def test_a_vehicle_reads_the_same_in_any_batch_and_by_its_seed_sequence():
    for one, other in zip(*(with_bias(EVERYTHING, flight(n, 60), RATE, 5) for n in (2, 9)), strict=True):
        assert np.array_equal(one, other[:2])
    children = np.random.SeedSequence(5).spawn(4)
    many = simulate_imu(ADIS, **at_rest(4, 20), rate_hz=RATE, seed=5)
    some = simulate_imu(ADIS, **at_rest(2, 20), rate_hz=RATE, seed=children[2:])
    assert np.array_equal(some, np.array(many)[:, 2:])


def test_seeds_and_axes_are_independent():
    gyro, accel = simulate_imu(only(ADIS, "noise"), **at_rest(2, 20_000), rate_hz=RATE, seed=0)
    channels = np.concatenate([gyro, accel - [0.0, 0.0, 9.81]], axis=-1).transpose(0, 2, 1).reshape(12, -1)
    assert np.abs(np.corrcoef(channels) - np.eye(12)).max() < 0.04


def test_other_number_types_and_layouts_are_taken():
    motion = {name: np.asfortranarray(series.astype(np.int64)) for name, series in flight(2, 5).items()}
    exact = {name: series.astype(float) for name, series in motion.items()}
    assert np.array_equal(
        *(simulate_imu(EVERYTHING, **each, rate_hz=RATE, seed=0) for each in (motion, exact))
    )


def test_reset_gives_a_new_flight_to_the_chosen_vehicles_only():
    ang_vel, force = np.zeros((3, 3)), np.tile([0.0, 0.0, 9.81], (3, 1))
    stream, undisturbed = ImuStream(ADIS, 3, RATE, seed=1), ImuStream(ADIS, 3, RATE, seed=1)
    for _ in range(10):
        first = stream.sample(ang_vel, force)
        undisturbed.sample(ang_vel, force)
    bias = stream.biases["gyro"].copy()
    stream.reset([1])
    assert np.array_equal(stream.biases["gyro"][[0, 2]], bias[[0, 2]])
    assert not np.isclose(stream.biases["gyro"][1], bias[1]).any()
    for _ in range(2 * BLOCK):
        after, going_on = stream.sample(ang_vel, force), undisturbed.sample(ang_vel, force)
        assert np.array_equal(after[0][[0, 2]], going_on[0][[0, 2]])
        assert not np.isclose(after[0][1], going_on[0][1], rtol=1e-9, atol=0.0).any()
    assert not np.isclose(first[0][1], after[0][1], rtol=1e-9, atol=0.0).any()


def test_resets_are_reproducible_whatever_happened_before():
    ang_vel, force = np.zeros((2, 3)), np.zeros((2, 3))
    spec = without(EVERYTHING, "vibration", "lever_arm")
    early, late = ImuStream(spec, 2, RATE, seed=1), ImuStream(spec, 2, RATE, seed=1)
    early.reset()
    for _ in range(BLOCK + 9):
        late.sample(ang_vel, force)
    late.reset()
    for _ in range(BLOCK + 9):
        assert np.array_equal(early.sample(ang_vel, force), late.sample(ang_vel, force))


# --- noise and bias -------------------------------------------------------------------------------


def allan_variance(sensor: Sensor, t: np.ndarray) -> np.ndarray:
    """White noise and first-order Gauss-Markov bias."""
    tau = sensor.time_constant
    assert tau is not None
    markov = 1.0 - tau / (2.0 * t) * (3.0 - 4.0 * np.exp(-t / tau) + np.exp(-2.0 * t / tau))
    return sensor.noise**2 / t + sensor.random_walk**2 * tau**2 / t * markov


def allan_ratios(name: str) -> dict[str, np.ndarray]:
    """Measured over expected Allan deviation of both sensors at 0.2 s to 300 s."""
    rate_hz, taus = 10.0, np.array([0.2, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0])
    spec = only(load_imu(name), "noise", "random_walk", "turn_on")
    readings = simulate_imu(spec, **at_rest(12, 60_000), rate_hz=rate_hz, seed=11)
    ratios = {}
    for sensor, series in zip(("gyro", "accel"), readings, strict=True):
        channels = series.transpose(0, 2, 1).reshape(-1, series.shape[1])
        each = [allantools.oadev(channel, rate_hz, "freq", taus)[1] ** 2 for channel in channels]
        ratios[sensor] = np.sqrt(np.mean(each, axis=0) / allan_variance(getattr(spec, sensor), taus))
    return ratios


@pytest.mark.parametrize("name", ["adis16448", "px4-mini"])
def test_allan_deviation_matches_datasheet(name):
    for ratio in allan_ratios(name).values():
        assert ratio[:4] == pytest.approx(np.ones(4), abs=0.02)
        assert ratio[4:] == pytest.approx(np.ones(3), abs=0.08)


@pytest.mark.parametrize("rate_hz", [1.0, 200.0])
def test_noise_density_does_not_depend_on_the_rate(rate_hz):
    gyro, accel = simulate_imu(only(ADIS, "noise"), **at_rest(20, 2000), rate_hz=rate_hz, seed=2)
    assert gyro.std() == pytest.approx(3.394e-4 * np.sqrt(rate_hz), rel=0.01)
    assert (accel - [0, 0, 9.81]).std() == pytest.approx(0.004 * np.sqrt(rate_hz), rel=0.01)


def test_bias_starts_at_and_keeps_its_stationary_spread():
    spec, rate_hz = only(ADIS, "random_walk"), 0.1
    _, _, gyro_bias, accel_bias = with_bias(spec, at_rest(3000, 100), rate_hz, 3)
    for bias, sensor in ((gyro_bias, spec.gyro), (accel_bias, spec.accel)):
        assert sensor.time_constant is not None
        stationary = sensor.random_walk * np.sqrt(sensor.time_constant / 2.0)
        spread = bias.std(axis=(0, 2))  # over 9000 channels, at each time
        assert spread == pytest.approx(np.full(100, stationary), rel=0.04)


def test_turn_on_bias_has_the_datasheet_spread_over_500_seeds():
    _, _, gyro_bias, accel_bias = with_bias(only(ADIS, "turn_on"), at_rest(500, 3), RATE, 7)
    assert np.array_equal(gyro_bias[:, 0], gyro_bias[:, -1])
    three_sigma = 3.0 / np.sqrt(2.0 * 1500)
    assert gyro_bias[:, 0].std() == pytest.approx(0.0087, rel=three_sigma)
    assert accel_bias[:, 0].std() == pytest.approx(0.196, rel=three_sigma)


def test_true_bias_is_what_the_reading_is_off_by_without_noise():
    spec = only(ADIS, "random_walk", "turn_on")
    gyro, accel, gyro_bias, accel_bias = with_bias(spec, at_rest(3, 200), RATE, 1)
    assert np.array_equal(gyro, gyro_bias)
    assert accel - [0.0, 0.0, 9.81] == pytest.approx(accel_bias, abs=1e-14)


# --- parts ----------------------------------------------------------------------------------------


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
    ang_vel = np.array([body_rate(roll, pitch, yaw, dt, k) for k in (2, 3, 4)])
    ang_acc = (ang_vel[2] - ang_vel[0]) / (2.0 * dt)
    acceleration = (point[4] - 2.0 * point[3] + point[2]) / dt**2
    expected = quat_rotate_inverse(quat[3], acceleration)
    spec = ImuSpec(lever_arm=tuple(arm))
    _, accel = simulate_imu(
        spec, ang_vel[1][None, None], np.zeros((1, 1, 3)), RATE, seed=0, ang_acc=ang_acc[None, None]
    )
    assert accel[0, 0] == pytest.approx(expected, abs=1e-5)


def body_rate(roll, pitch, yaw, dt, k):
    """Body rate from the rates of intrinsic z-y'-x'' angles."""
    dr, dp, dy = ((angle[k + 1] - angle[k - 1]) / (2.0 * dt) for angle in (roll, pitch, yaw))
    sr, cr, sp, cp = np.sin(roll[k]), np.cos(roll[k]), np.sin(pitch[k]), np.cos(pitch[k])
    return np.array([dr - dy * sp, dp * cr + dy * cp * sr, -dp * sr + dy * cp * cr])


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("rate_hz", [50.0, 200.0, 1000.0])
def test_low_pass_delays_a_ramp_by_its_closed_form_at_any_rate(order, rate_hz):
    sensor = Sensor(low_pass_hz=30.0, low_pass_order=order)
    time = np.arange(400) / rate_hz
    ramp = np.repeat(4.0 * time[None, :, None], 3, axis=2)
    gyro, accel = simulate_imu(ImuSpec(gyro=sensor, accel=sensor), ramp, ramp + 1.0, rate_hz, seed=0)
    delay = (1.0 if order == 1 else np.sqrt(2.0)) / (2.0 * np.pi * 30.0)
    settled = int(0.3 * rate_hz)
    assert gyro[:, settled:] == pytest.approx(ramp[:, settled:] - 4.0 * delay, abs=1e-9)
    assert accel[:, settled:] == pytest.approx(gyro[:, settled:] + 1.0, abs=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_low_pass_has_the_butterworth_response(order):
    sensor, rate_hz = Sensor(low_pass_hz=30.0, low_pass_order=order), 8000.0
    time = np.arange(8000) / rate_hz
    for frequency in (10.0, 30.0, 90.0):
        wave = np.repeat(np.sin(2.0 * np.pi * frequency * time)[None, :, None], 3, axis=2)
        gyro, _ = simulate_imu(ImuSpec(gyro=sensor), wave, wave, rate_hz, seed=0)
        _, response = signal.freqs(
            *signal.butter(order, 2.0 * np.pi * 30.0, analog=True), 2.0 * np.pi * frequency
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


# --- bad input and extremes -----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ang_vel", "specific_force", "ang_acc", "rotor_vel"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(name, value):
    motion = flight(2, 5)
    motion[name][1, 3, 2] = value
    with pytest.raises(ValueError, match=rf"{name}\[1, 3, 2\] is -?(nan|inf); all numbers must be finite"):
        simulate_imu(EVERYTHING, **motion, rate_hz=RATE, seed=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ang_vel": np.zeros((5, 3))}, r"needs ang_vel of shape \(n, T, 3\), .* not \(5, 3\)"),
        ({"specific_force": np.zeros((2, 4, 3))}, r"n × T = \(2, 5\), not \(2, 4, 3\)"),
        ({"rotor_vel": np.zeros((2, 5, 13))}, r"\(n, T, at most 12 rotors\), .* not \(2, 5, 13\)"),
        ({"ang_acc": None}, "needs ang_acc .* not nothing"),
        ({"rotor_vel": None}, "needs rotor_vel"),
        ({"rate_hz": 0.0}, "rate_hz = 0"),
        ({"seed": -3}, "seed is -3"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        simulate_imu(EVERYTHING, **({**flight(2, 5), "rate_hz": RATE, "seed": 0} | change))


def test_a_stream_needs_what_its_imu_needs():
    with pytest.raises(ValueError, match="needs ang_acc"):
        ImuStream(EVERYTHING, 1, RATE, 0).sample(np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="needs ang_vel"):
        ImuStream(ADIS, 2, RATE, 0).sample(np.zeros((3, 3)), np.zeros((2, 3)))


@settings(max_examples=80, deadline=None)
@given(
    size=st.floats(0.0, 1e30),
    rate_hz=st.floats(1e-2, 1e5),
    low_pass_hz=st.floats(0.01, 1e4),
    seed=st.integers(0, 2**64),
)
def test_no_motion_gives_a_reading_out_of_range(size, rate_hz, low_pass_hz, seed):
    gyro = EVERYTHING.gyro.model_copy(update={"low_pass_hz": low_pass_hz})
    spec = EVERYTHING.model_copy(update={"gyro": gyro})
    motion = {name: size * series for name, series in flight(2, 12).items()}
    gyro, accel, *biases = with_bias(spec, motion, rate_hz, seed)
    assert np.abs(gyro).max() <= spec.gyro.saturation
    assert np.abs(accel).max() <= spec.accel.saturation
    assert np.isfinite(biases).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[accel]\nrandom_walk = 0.1", "needs a time_constant"),
        ("[accel]\nresolution = 2\nsaturation = 1", "must not exceed saturation"),
    ],
)
def test_bad_imu_file_is_one_clear_line(tmp_path, text, message):
    path = tmp_path / "imu.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"imu\.toml") as caught:
        load_imu(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


# --- presets --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", preset_names("imus"))
def test_preset_survives_json(name):
    spec = load_imu(name)
    assert ImuSpec.model_validate_json(spec.model_dump_json()) == spec


def test_adis16448_has_the_numbers_of_rotors():
    for sensor, numbers in (
        (ADIS.gyro, (3.394e-4, 3.8785e-5, 1000, 0.0087)),
        (ADIS.accel, (0.004, 0.006, 300, 0.196)),
    ):
        assert (sensor.noise, sensor.random_walk, sensor.time_constant, sensor.turn_on) == numbers
    assert ADIS.gyro.saturation == pytest.approx(np.radians(1000.0))
    assert ADIS.accel.saturation == pytest.approx(18 * 9.80665)
    rotors = ("noise", "random_walk", "turn_on", "saturation")
    assert only(ADIS, *rotors) == ADIS


def test_px4_mini_is_another_domain():
    px4 = load_imu("px4-mini")
    assert px4.gyro.noise == pytest.approx(np.radians(0.006), rel=0.01)
    assert px4.accel.noise == pytest.approx(150e-6 * 9.80665, rel=0.01)
    assert px4.gyro.resolution == pytest.approx(np.radians(2000.0) / 2**15)
    assert px4.accel.resolution == pytest.approx(16 * 9.80665 / 2**15)
    assert px4.gyro.saturation == pytest.approx(np.radians(2000.0))
