"""The circuit that follows turns: its equation, its spikes neuron by neuron, and what it makes of flights."""

import numpy as np
import pytest
from controllers import samples
from plain_circuit import PlainCircuit, plain_floats

from estimators import create, run
from estimators.circuit.circuit_estimator import SCALING, Silent, circuit_estimator
from estimators.circuit.file import CircuitConfig, is_circuit, load_circuit, save_circuit
from estimators.circuit.floats import new_trace, run_floats, stepped
from estimators.circuit.on_chip import place, populations
from estimators.circuit.parameters import (
    GRAVITY,
    RATE_HZ,
    quantised,
    untrained,
)
from estimators.circuit.spikes import SpikingCircuit
from estimators.metrics import inclination_error
from estimators.networks.network import NetworkEstimator
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import changed, load_scenario
from quadsim.rotation import quat_from_rotvec, quat_rotate_inverse, roll_pitch_from_quat, roll_pitch_of_up

NAMES = ("att-snn", "att-rnn")
SHIPPED = "att-snn"


def turning(steps, seconds_before_turn=0.0, axis=(1.0, 2.0, 0.5), speed=2.0):
    t = np.arange(1, steps + 1) / RATE_HZ
    rate = speed * np.array(axis) / np.linalg.norm(axis)
    rate = np.rint(rate * 2**17 / RATE_HZ) * RATE_HZ / 2**17  # what an integer input can say
    angle = rate * np.maximum(0, t - seconds_before_turn)[:, None]
    quat = quat_from_rotvec(angle)
    gyro = rate * (t > seconds_before_turn + 1e-9)[:, None]
    return gyro[None], GRAVITY * quat_rotate_inverse(quat, [0.0, 0.0, 1.0])[None], roll_pitch_from_quat(quat)


@pytest.mark.parametrize("scenario", ["hover", "wind-8"])
def test_a_vehicle_that_begins_with_a_dash_is_not_turned_over(scenario):
    """In a dash the force says level, whatever the tilt; nothing says how the vehicle was tilted before."""
    start = {"speed": 5.0, "known_attitude": False}
    flown = changed(load_scenario(scenario), {"start": start})
    mission = Mission(flown, create(SHIPPED, RATE_HZ), 4, RATE_HZ)
    mission.begin(np.random.SeedSequence(5).spawn(4))
    for _ in range(600):
        mission.step()
    assert not mission.cause.any()


@pytest.mark.parametrize(
    ("name", "speed", "allowed_deg"),
    [
        ("att-rnn", 1.0, 0.1),
        ("att-rnn", 3.0, 0.2),
        ("att-snn", 1.0, 3.0),
        ("att-snn", 3.0, 1.5),
        ("att-snn", 15.0, 1.5),
    ],
)
def test_a_vector_that_nothing_pulls_follows_ten_turns(name, speed, allowed_deg):
    steps = round(20 * np.pi / speed * RATE_HZ)
    gyro, accel, truth = turning(steps, speed=speed)
    p = untrained()
    zero = {each: 0 * getattr(p, each) for each in ("mix", "pull", "give", "take", "read", "learn")}
    est = circuit_estimator(name, p._replace(**zero, start=np.ones_like(p.start), scale=np.full(4, 1.2)))
    found = est.sequence(gyro, accel)
    assert inclination_error(found[0, -1], truth[-1]) < allowed_deg
    assert np.linalg.norm(est.up[0]) == pytest.approx(1, abs=0.06)


@pytest.mark.parametrize("name", NAMES)
def test_untrained_it_finds_up_from_any_start_and_keeps_it_in_a_turn(name):
    tilted = quat_from_rotvec(2.5 * np.array([0.6, -0.8, 0.0]))
    gyro, accel = (quat_rotate_inverse(tilted, each) for each in turning(5000, 12.0)[:2])
    est = circuit_estimator(name, untrained()._replace(scale=np.full(4, 1.2)))
    error = inclination_error(est.sequence(gyro, accel), roll_pitch_of_up(accel))[0]
    assert error[0] > 100
    assert error[2300:].max() < 4
    assert error[-200:].max() < 1.5


@pytest.mark.parametrize("name", NAMES)
def test_learning_the_gyroscopes_bias_takes_most_of_its_error_away(name):
    gyro, accel, truth = turning(12000, speed=0.0)
    errors = []
    for p in (untrained(), untrained()._replace(learn=np.zeros(1))):
        est = circuit_estimator(name, p._replace(scale=np.full(4, 1.2)))
        estimate = est.sequence(gyro + np.array([0.03, -0.02, 0.01]), accel)[0]
        errors.append(inclination_error(estimate, truth)[-400:].mean())
    assert errors[0] < errors[1] / 2


@pytest.mark.parametrize("steps", [1, 2, 4])
def test_the_kernel_is_the_circuit_neuron_by_neuron(steps):
    p = untrained(5, 11, seed=1, weight_noise=3.0)
    p = p._replace(scale=np.array([1.2, 1.1, 0.5, 2.0, 0.9]), resume=np.linspace(-0.5, 1.5, 11))
    circuit = quantised(p, steps)
    est = NetworkEstimator(SpikingCircuit(SCALING, circuit, 1, steps, p.scale[1]), RATE_HZ)
    plain = PlainCircuit(circuit, steps)
    gyro, accel = samples(1, 150, 5, 3.0, 4.0)
    gyro[0, 60:80], accel[0, 100:110] = 30.0, 150.0  # more than the encoders can say at once
    gyro[0, 115:140] = np.nan
    spikes = 0
    for t in range(150):
        est.update(gyro[:, t], accel[:, t])
        state = est.states[0]
        if t == 140:
            plain.g += circuit.levels[4]
        for _ in range(steps):
            plain.step(state["inputs"].astype(int))
        axes_first = {"x": plain.x.T, "y": plain.y.T, "z": plain.z.T, "gate": plain.g, "felt": plain.h}
        for name, value in axes_first.items():
            np.testing.assert_array_equal(state[name], value.ravel(), name)
        np.testing.assert_array_equal(state["bias"][:3], plain.b)
        spikes += np.abs(plain.d).sum()
    assert spikes > 50
    assert np.abs(plain.b).min() > 0


def test_weights_are_ones_that_the_chip_has():
    circuit = quantised(untrained(6, 16, seed=2, weight_noise=5.0), 4)
    for name in ("mix", "pull", "give", "take", "read", "gate"):
        size = np.abs(getattr(circuit, name).astype(np.int64))
        size = size[size >= 128]
        unit = 2 ** (np.floor(np.log2(size)).astype(int) - 6)
        assert size.size > 0
        assert not (size % unit).any(), name
    assert circuit.levels[2].min() >= 1


def test_the_network_that_ships_fits_one_chip():
    config, p = load_circuit(SHIPPED)
    circuit = quantised(p, config.steps_per_sample)
    assert sum(each.neurons for each in populations(circuit)) <= 1024
    assert place(circuit) <= 2
    assert type(create("att-snn-loihi", weights=SHIPPED)) is type(create(SHIPPED))


def test_spikes_cost_little(hummingbird):
    errors = {}
    for name in NAMES:
        estimate = run(create(name, weights=SHIPPED), hummingbird.gyro[:2], hummingbird.accel[:2])
        errors[name] = inclination_error(estimate, hummingbird.truth[:2])[:, 1000:].mean()
    assert errors["att-rnn"] < 4
    assert abs(errors["att-snn"] - errors["att-rnn"]) < 0.3


@pytest.mark.parametrize("name", NAMES)
def test_an_absurd_sample_is_refused_and_half_a_second_without_samples_is_forgotten(hummingbird, name):
    gyro, accel = hummingbird.gyro[:2], hummingbird.accel[:2]
    absurd, lost = (gyro.copy(), accel.copy()), (gyro.copy(), accel.copy())
    absurd[0][:, 2000], absurd[1][:, 2000] = 1e30, -1e30
    for each in lost:
        each[:, 2000:2100] = np.nan
    est = create(name, weights=SHIPPED)
    errors = []
    for readings, skipped in (((gyro, accel), 0), (absurd, 1), (lost, 100)):
        errors.append(inclination_error(run(est, *readings), hummingbird.truth[:2])[:, 4800:].mean())
        assert est.skipped[0] == skipped
    assert errors[1] == pytest.approx(errors[0], abs=0.5)
    assert errors[2] == pytest.approx(errors[0], abs=1.5)


def test_a_silent_network_is_level_and_counts_missing_samples():
    est, (gyro, accel) = NetworkEstimator(Silent(), RATE_HZ), samples(2, 50)
    gyro[0, 5], accel[0, 9] = np.nan, np.nan
    est.reset(2)
    assert not est.sequence(gyro, accel).any()
    assert est.skipped.tolist() == [2, 0]


def test_a_file_is_read_back_and_the_same_bytes(tmp_path):
    p = untrained(5, 9, seed=4, weight_noise=1.0)
    config = CircuitConfig(vectors=5, gates=9, training={"seed": 4})
    for k in range(3):
        save_circuit(tmp_path / f"{k}.safetensors", config, p)
    assert len({(tmp_path / f"{k}.safetensors").read_bytes() for k in range(3)}) == 1
    found = load_circuit(tmp_path / "0.safetensors")
    assert found.config == config
    for ours, theirs in zip(p, found.parameters, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert is_circuit(tmp_path / "0.safetensors")
    assert not is_circuit("att-snn-paper")
    gyro, accel = samples(1, 20)
    assert create(str(tmp_path / "0.safetensors")).sequence(gyro, accel).shape == (1, 20, 2)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mix": np.zeros((2, 3, 3))}, r"tensor mix has shape \(2, 3, 3\), should be \(2, 4, 4\)"),
        ({"pull": np.full((2, 4), np.nan)}, "tensor pull has values that are not finite"),
        ({"level": np.zeros(8, np.float32)}, "tensor level is float32"),
        ({"pairs": np.array([[4, 6]])}, "pairs name a vector or a gate that is not there"),
        ({"tau": np.zeros(8)}, "tau and scale should be above 0"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(tmp_path, change, said):
    with pytest.raises(ValueError, match=said):
        save_circuit(tmp_path / "x", CircuitConfig(vectors=4, gates=8), untrained()._replace(**change))


def test_other_files_are_refused_in_one_line(tmp_path):
    (tmp_path / "x.safetensors").write_bytes(b"no")
    for load, error, said in (
        (lambda: load_circuit(tmp_path / "x.safetensors"), ValueError, "not a safetensors file"),
        (lambda: load_circuit("assets/weights/att-snn-paper.safetensors"), ValueError, "not a circuit"),
        (lambda: load_circuit(tmp_path / "none"), FileNotFoundError, "no such file of a circuit"),
        (lambda: create(SHIPPED, 100.0), ValueError, "the circuit is for 200 Hz, not for 100 Hz"),
    ):
        with pytest.raises(error, match=said):
            load()


@pytest.mark.parametrize("faster", [1, 300])
def test_floats_are_the_equations(faster):
    p = untrained(5, 11, seed=2, weight_noise=3.0)
    p = p._replace(learn=faster * p.learn, resume=np.linspace(-0.5, 1.5, 11))
    gyro, accel = samples(2, 300, 3, 3.0, 4.0)
    again = np.arange(300)[:, None] == [100, 200]
    trace, senses = new_trace(p, 300, 2)
    angle, force = (
        np.ascontiguousarray(each.transpose(1, 2, 0), np.float32)
        for each in (gyro / RATE_HZ, accel / GRAVITY)
    )
    run_floats(angle, force, again, stepped(p), trace, senses)
    found = np.concatenate([trace.x[1:, 1], trace.bias[1:]], 1)
    for n in range(2):
        np.testing.assert_allclose(found[:, :, n], plain_floats(p, gyro[n], accel[n], again[:, n]), atol=2e-4)
    assert (np.abs(trace.bias).max() > np.radians(11.1)) == (faster == 300)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["att-rnn", "att-snn"])
def test_at_rest_at_any_tilt_the_estimate_settles_within_two_degrees(name):
    tilts = np.radians([5, 10, 20, 25, 40, 60])
    force = 9.81 * np.column_stack([0 * tilts, np.sin(tilts), np.cos(tilts)])
    accel = np.repeat(force[:, None], 8000, axis=1)
    roll = np.degrees(run(create(name, rate_hz=200.0), np.zeros_like(accel), accel)[:, -400:, 0].mean(1))
    np.testing.assert_allclose(roll, np.degrees(tilts), atol=2)
