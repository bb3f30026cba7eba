import allantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imu_errors import ADIS, EVERYTHING, RATE, at_rest, flight, only, without

from quadsim.imu.spec import ImuSpec, Sensor, load_imu
from quadsim.imu.stream import BLOCK, ImuStream, motion_of, simulate_imu, simulate_readings


def with_bias(spec: ImuSpec, motion: dict[str, np.ndarray], rate_hz: float, seed: int):
    """Readings of the gyroscope and the accelerometer, and their true biases."""
    return simulate_readings(spec, motion_of(spec, **motion), rate_hz, seed).values()


def stream_through(stream: ImuStream, motion: dict[str, np.ndarray]) -> np.ndarray:
    steps = motion["ang_vel"].shape[1]
    samples = ({name: series[:, t] for name, series in motion.items()} for t in range(steps))
    return np.stack([stream.sample(**each) for each in samples], axis=2)


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


def allan_variance(sensor: Sensor, t: np.ndarray) -> np.ndarray:
    tau = sensor.time_constant
    assert tau is not None
    markov = 1.0 - tau / (2.0 * t) * (3.0 - 4.0 * np.exp(-t / tau) + np.exp(-2.0 * t / tau))
    return sensor.noise**2 / t + sensor.random_walk**2 * tau**2 / t * markov


@pytest.mark.parametrize("name", ["adis16448", "px4-mini"])
def test_allan_deviation_matches_datasheet(name):
    rate_hz, taus = 10.0, np.array([0.2, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0])
    spec = only(load_imu(name), "noise", "random_walk", "turn_on")
    readings = simulate_imu(spec, **at_rest(12, 60_000), rate_hz=rate_hz, seed=11)
    for sensor, series in zip((spec.gyro, spec.accel), readings, strict=True):
        channels = series.transpose(0, 2, 1).reshape(-1, series.shape[1])
        each = [allantools.oadev(channel, rate_hz, "freq", taus)[1] ** 2 for channel in channels]
        ratio = np.sqrt(np.mean(each, axis=0) / allan_variance(sensor, taus))
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
    with pytest.raises(ValueError, match=rf"^.*imu\.toml.*{message}[^\n]*$"):
        load_imu(path)


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
