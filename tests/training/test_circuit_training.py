"""The circuit's gradient, its streams and IMUs, and a run that was stopped ends as if it was not."""

import numpy as np
import pytest

from estimators.circuit.file import load_circuit
from estimators.circuit.parameters import FAST, LEARNT, untrained
from quadsim.dataset import generate
from quadsim.flight.recipe import load_recipe
from quadsim.imu.spec import ImuSpec, Sensor
from training.augment import measured, turned_and_mirrored
from training.circuit.gradient import loss_and_gradient
from training.circuit.imus import draw_imu
from training.circuit.start import QUICK, as_flown, settling_s
from training.circuit.streams import Streams, bias_of, draw_streams, hold_last, interrupt, sway
from training.config import CircuitTraining, make_config
from training.data import load_training_flights
from training.epochs import INTERRUPTED, train


def batch(seed=0, steps=200, n=6):
    rng = np.random.default_rng(seed)
    angle, force = rng.normal(0, 0.02, (steps, 3, n)), rng.normal([[0], [0], [1]], 0.3, (steps, 3, n))
    up = rng.normal([[0], [0], [2]], 0.3, (steps, 3, n))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    bias, known = rng.normal(0, 0.02, (3, n)), np.arange(n) < n // 2
    angle, force, up, bias = (each.astype(np.float32) for each in (angle, force, up, bias))
    return Streams(angle, force, rng.random((steps, n)) < 0.02, up, bias, known), np.ones(n, np.float32)


@pytest.mark.parametrize("name", LEARNT)
def test_the_gradient_is_the_slope_of_the_loss_along_any_direction(name):
    rng = np.random.default_rng(1)
    p = untrained(5, 10, seed=1, weight_noise=2.0)
    # gates that depend on nothing and are between shut and open, where the gradient is exact
    p = p._replace(gate=0 * p.gate, level=rng.uniform(0.3, 0.7, 10))
    p = p._replace(onset=0 * p.onset, resume=0 * p.resume)
    _, slope, _ = loss_and_gradient(p, *batch())
    value = getattr(p, name)
    direction = rng.standard_normal(value.shape)
    size = 2e-3 if name != "gate" else 1e-3
    moved = (p._replace(**{name: value + k * size * direction}) for k in (1, -1))
    sides = [loss_and_gradient(each, *batch())[0] for each in moved]
    expected = (getattr(slope, name) * direction).sum()
    assert abs(expected) > 1e-6
    assert (sides[0] - sides[1]) / (2 * size) == pytest.approx(expected, rel=0.05)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("circuit")
    return tuple(
        str(generate(load_recipe(recipe), 3, 6.0, folder / f"{recipe}.zarr", seed=seed, workers=1))
        for recipe, seed in (("hummingbird", 1), ("hand-held", 2))
    )


SHORT = {
    "preset": "att-snn", "updates": 600, "streams": 8, "batch_size": 2, "window_s": 0.1,
    "vectors": 4, "gates": 8, "seed": 3,
}  # fmt: skip


def test_a_stopped_run_ends_as_one_that_was_not(tmp_path, data):
    choices = SHORT | {"data": data, "validation": data[:1]}
    whole = train(out=tmp_path / "whole", **choices)

    def stop(epoch, run):
        raise KeyboardInterrupt

    stopped = train(out=tmp_path / "parts", progress=stop, **choices)
    assert (stopped.reason, stopped.best.updates, stopped.best.validation) == (INTERRUPTED, 500, {})
    assert load_circuit(stopped.weights).config.training["updates"] == 500
    parts = train(out=tmp_path / "parts", **choices)
    np.testing.assert_equal([*load_circuit(parts.weights)[1]], [*load_circuit(whole.weights)[1]])
    assert whole.best.validation == parts.best.validation
    assert {each.name for each in (tmp_path / "parts").iterdir()} >= {"log.csv", "curve.png", "config.json"}
    with pytest.raises(ValueError, match="holds a run with another configuration"):
        train(out=tmp_path / "parts", **choices | {"seed": 4})
    config, p = load_circuit(whole.weights)
    assert config.training["training_flights"] == 6
    assert np.abs(p.mix - untrained(4, 8, 3, 1.0).mix).max() > 1e-3
    little = {"updates": 1, "streams": 8, "batch_size": 2, "window_s": 0.1, "learning_rate": 1e-6}
    little |= {"preset": "tune", "data": data, "validation": data[:1], "init": str(whole.weights)}
    tuned = make_config(**little)
    assert (tuned.vectors, tuned.gates) == (4, 8)
    after = train(out=tmp_path / "on", **little)
    before = after.best.validation["hummingbird_before_training_deg"]
    assert {"hummingbird_deg": before} == whole.best.validation
    np.testing.assert_allclose(load_circuit(after.weights).parameters.mix, p.mix, atol=1e-5)


def test_a_run_with_flights_that_are_too_short_leaves_no_folder(data, tmp_path):
    with pytest.raises(ValueError, match="window_s: 40, but the shortest flight has 6 s"):
        train(data=data, preset="att-snn", out=tmp_path)
    assert not list(tmp_path.iterdir())  # the folder is free for a run that is right


def test_a_validation_set_that_is_not_there_is_refused_before_the_training(data, tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        train(data=data, validation=("nowhere.zarr",), out=tmp_path / "run", **SHORT)
    assert not (tmp_path / "run" / "config.json").exists()


def test_streams_are_readings_and_their_up(data):
    parts = [load_training_flights([path]) for path in data]
    assert [part.vehicles for part in parts] == [("hummingbird",), ()]
    recipe = CircuitTraining(streams=70, hand_share=0.5, known_share=0.5)
    streams = draw_streams(parts, recipe, 400, np.random.default_rng(0))
    for each in (streams.angle, streams.force, streams.up):
        assert each.shape == (400, 3, 70)
        assert np.isfinite(each).all()
    assert 20 < streams.known.sum() < 50
    assert (streams.force * streams.up).sum(1).mean() == pytest.approx(1, abs=0.2)
    assert np.abs(streams.angle).mean() < 0.05
    np.testing.assert_allclose(np.linalg.norm(streams.up, axis=1), 1, atol=1e-5)
    again = draw_streams(parts, recipe, 400, np.random.default_rng(0))
    np.testing.assert_array_equal(streams.force, again.force)


def test_after_a_gap_longer_than_the_host_bridges_readings_resume_and_rates_were_zero():
    readings = np.full((2, 40, 400, 3), 5.0, np.float32)
    again = interrupt(readings, 1.0, 200.0, np.random.default_rng(3))
    ends = np.argwhere(again)
    assert 10 < len(ends) <= 40
    for row, end in ends:
        assert not readings[0, row, end - 1].any()
        assert (readings[1] == 5.0).all()


def test_the_start_that_flies_closes_fast_gates_soon_and_finds_a_tilt_sooner():
    p = untrained()
    flown, quick = as_flown(p), p._replace(tau=np.where([2 <= k < 4 for k in range(8)], QUICK, p.tau))
    np.testing.assert_array_equal(flown.tau, quick.tau)
    assert QUICK < FAST / 4
    assert np.count_nonzero(flown.onset != p.onset) <= 1
    assert settling_s(flown) <= settling_s(quick)
    assert all(
        np.array_equal(getattr(p, each), getattr(flown, each))
        for each in p._fields
        if each not in ("tau", "onset")
    )


def test_a_hand_sways_within_bounds():
    """Twice integrated, what a resting hand feels besides gravity is a position within a metre."""
    steps, rng = 8000, np.random.default_rng(5)
    rest = np.zeros((12, steps, 3), np.float32)
    up = np.tile(np.float32([0, 0, 1]), (12, steps, 1))
    added = sway(rest, 9.81 * up, up, 0.7, 200.0, rng) - 9.81 * up
    assert np.abs(added).max() > 5
    place = np.cumsum(np.cumsum(added.astype(float), 1), 1) / 200**2
    assert np.abs(place).max() < 1.5


def test_the_bias_of_a_stream_is_found_where_up_tells_it():
    rng, rate = np.random.default_rng(4), 200.0
    t = np.arange(4000) / rate
    roll, pitch = 0.4 * np.sin(t), 0.3 * np.cos(0.7 * t)
    up = np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], 1)
    rate_of = np.cross(-up, np.gradient(up, axis=0) * rate)  # the smallest rate that turns up so
    bias = rng.normal(0, 0.05, 3)
    measured = rate_of + bias
    measured[2000:2010, 0] = 60.0  # false rates
    found = bias_of(measured[None], up[None], rate)[0]
    np.testing.assert_allclose(found, bias, atol=1e-2)
    resting = bias_of(np.tile(bias, (1, 100, 1)), np.tile([0.0, 0.0, 1.0], (1, 100, 1)), rate)[0]
    np.testing.assert_allclose(resting, [bias[0], bias[1], 0.0], atol=1e-3)


def test_lost_readings_are_the_last_good_ones():
    readings = np.arange(18.0).reshape(1, 6, 3)
    readings[0, [0, 3, 4]] = np.nan
    found = hold_last(readings)[0]
    assert found[0].tolist() == [0, 0, 0]
    assert found[3].tolist() == found[4].tolist() == [6, 7, 8]


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
    shaken = ImuSpec(vibration=make_config("att-snn", data="x").imu.vibration)
    assert measured(shaken, zero, zero, 200.0, np.random.default_rng(0))[1].std() > 1


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
