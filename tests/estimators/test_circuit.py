"""The circuit that follows turns: its equation, its spikes neuron by neuron, and what it makes of flights."""

import numpy as np
import pytest
from controllers import samples

from estimators import create, run
from estimators.circuit.circuit_estimator import SCALING, Silent, circuit_estimator
from estimators.circuit.circuit_records import ANGLE_DIGITS, INNOVATION, ONE, RING
from estimators.circuit.file import CircuitConfig, is_circuit, load_circuit, save_circuit
from estimators.circuit.floats import new_trace, run_floats, stepped
from estimators.circuit.on_chip import place, populations
from estimators.circuit.parameters import (
    GRAVITY,
    RATE_HZ,
    Parameters,
    quantised,
    untrained,
)
from estimators.circuit.spikes import SpikingCircuit
from estimators.networks.network import NetworkEstimator
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import changed, load_scenario
from quadsim.imu import load_imu, simulate_imu
from quadsim.rotation import quat_from_rotvec, quat_rotate_inverse

NAMES = ("att-snn", "att-rnn")
SHIPPED = "att-snn"
LEVEL = np.array([0.0, 0.0, 1.0])


def inclination_deg(estimate, up):
    cosine = (estimate * up).sum(-1) / (np.linalg.norm(estimate, axis=-1) * np.linalg.norm(up, axis=-1))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def turning(steps, seconds_before_turn=0.0, axis=(1.0, 2.0, 0.5), speed=2.0):
    """Readings of a body at rest, or turning in place; and its up."""
    t = np.arange(1, steps + 1) / RATE_HZ
    rate = speed * np.array(axis) / np.linalg.norm(axis)
    rate = np.rint(rate * 2**17 / RATE_HZ) * RATE_HZ / 2**17  # what an integer input can say
    angle = rate * np.maximum(0, t - seconds_before_turn)[:, None]
    up = quat_rotate_inverse(quat_from_rotvec(angle), np.tile([0, 0, 1.0], (steps, 1)))
    gyro = rate * (t > seconds_before_turn + 1e-9)[:, None]
    return gyro[None], GRAVITY * up[None], up


def free(p):
    """The circuit without pulls: vectors turn and nothing else."""
    zero = {name: 0 * getattr(p, name) for name in ("mix", "pull", "give", "take", "read", "learn")}
    return p._replace(**zero, start=np.ones_like(p.start))


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
    gyro, accel, up = turning(steps, speed=speed)
    est = circuit_estimator(name, free(untrained())._replace(scale=np.full(4, 1.2)))
    est.sequence(gyro, accel)
    assert inclination_deg(est.up[0], up[-1]) < allowed_deg
    assert np.linalg.norm(est.up[0]) == pytest.approx(1, abs=0.06)


@pytest.mark.parametrize("name", NAMES)
def test_untrained_it_finds_up_from_any_start_and_keeps_it_in_a_turn(name):
    gyro, accel, up = turning(5000, seconds_before_turn=12.0)
    tilted = quat_from_rotvec(2.5 * np.array([0.6, -0.8, 0.0]))
    gyro, accel, up = (
        quat_rotate_inverse(np.broadcast_to(tilted, (*each.shape[:-1], 4)), each)
        for each in (gyro, accel, up)
    )
    est = circuit_estimator(name, untrained()._replace(scale=np.full(4, 1.2)))
    error = inclination_deg(est.outputs(gyro, accel)[0] + LEVEL, up)
    assert error[0] > 100
    assert error[2300:].max() < 4
    assert error[-200:].max() < 1.5


@pytest.mark.parametrize("name", NAMES)
def test_learning_the_gyroscopes_bias_takes_most_of_its_error_away(name):
    gyro, accel, up = turning(12000, speed=0.0)
    errors = []
    for p in (untrained(), untrained()._replace(learn=np.zeros(1))):
        est = circuit_estimator(name, p._replace(scale=np.full(4, 1.2)))
        estimate = est.outputs(gyro + np.array([0.03, -0.02, 0.01]), accel)[0] + LEVEL
        errors.append(inclination_deg(estimate, up)[-400:].mean())
    assert errors[0] < errors[1] / 2


def test_a_quarter_turn_of_the_body_turns_the_estimate():
    p = untrained(6, 16, seed=3, weight_noise=1.0)
    gyro, accel = samples(1, 200, 0, 3.0, 4.0)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    straight = circuit_estimator("att-rnn", p).outputs(gyro, accel)
    turned = circuit_estimator("att-rnn", p).outputs(gyro @ quarter.T, accel @ quarter.T)
    np.testing.assert_allclose(turned, straight @ quarter.T, atol=1e-3)


# --- neuron by neuron ---------------------------------------------------------------------------------


def digits(n, count):
    """Balanced ternary digits of n, least first."""
    found = []
    for _ in range(count):
        digit = (n + 1) % 3 - 1
        found.append(digit)
        n = (n - digit) // 3
    assert n == 0
    return np.array(found)


def keep(x, d):
    return int(np.sign(x)) * (abs(int(x)) * (4096 - int(d)) >> 12)


def clip(x):
    return max(-(2**23) + 1, min(2**23 - 1, int(x)))


def signed(v, one):
    return int(v > one // 2) - int(v < -(one // 2))


class PlainCircuit:
    """The circuit with a coincidence neuron for each digit, axis and two signs, and with its delays."""

    def __init__(self, circuit, steps):
        self.c, self.steps = circuit, steps
        v, q = len(circuit.start), len(circuit.gate)
        self.x = np.zeros((v, 3), int)
        self.x[:, 2] = circuit.start
        self.y, self.coincident = np.zeros((v, 3), int), np.zeros((v, 3), int)
        self.f, self.z, self.d = (np.zeros((q, 3), int) for _ in range(3))
        self.g, self.h = circuit.levels[1].astype(int), np.zeros((3, 3), int)
        self.b, self.b_soma, self.b_spikes, self.b_due = (np.zeros(3, int) for _ in range(4))
        self.waiting, self.t = np.zeros((2, 3), int), 0

    def encoders(self, inputs):
        unbiased = inputs.reshape(2, 3) - np.array([64 * self.b_spikes, 0 * self.b_spikes])
        n = np.zeros((2, 3), int)
        for k, (units, most) in enumerate(((128, 121), (256, 40))):
            self.waiting[k] += unbiased[k]
            n[k] = np.clip(np.floor((self.waiting[k] + units // 2) / units), -most, most)
            self.waiting[k] = np.clip(self.waiting[k] - units * n[k], -(2**14), 2**14)
        return n

    def step(self, inputs):
        c, ring = self.c, int(RING[self.t % len(RING)])
        self.t += 1
        n_w, n_a = self.encoders(inputs)
        soma = np.vectorize(clip)(self.y + self.x)
        s = np.vectorize(signed)(soma, ONE)
        self.y = soma - ONE * s
        plus, minus = s > 0, s < 0
        soma = np.vectorize(clip)(self.b_soma + self.b)
        self.b_spikes = np.vectorize(signed)(soma, 2**22)
        self.b_soma = soma - 2**22 * self.b_spikes
        self.b, self.b_due = np.vectorize(clip)(self.b + self.b_due), np.zeros(3, int)
        opened = self.g + c.levels[0] > ring
        fires = 4 * np.abs(self.h) > ring
        heard = [fires[0, :2].sum(), fires[0, 2], fires[1, :2].sum(), fires[1, 2], fires[2].sum()]
        self.g = np.array(
            [
                clip(keep(g, d) + w @ np.array(heard, int))
                for g, d, w in zip(self.g, c.levels[2], c.gate, strict=True)
            ]
        )
        felt, to_force, to_turn, to_first, still = map(int, c.sense)
        push = [to_force * n_a - [0, 0, still], to_turn * n_w, to_force * n_a - to_first * s[0]]
        self.h = np.array(
            [
                [clip(keep(h, felt) + p) for h, p in zip(*each, strict=True)]
                for each in zip(self.h, push, strict=True)
            ]
        )
        turned = self.coincident
        for i in range(3):
            self.x[:, i] += c.mix[i].astype(int).T @ s[:, i] + c.pull[i] * n_a[i] - turned[:, i]
            self.x[:, i] += c.give[i].astype(int).T @ self.d[:, i]
        self.x = np.vectorize(clip)(self.x)
        self.y = np.vectorize(clip)(self.y - turned * 3 // 2)
        self.coincident = self.products(n_w, plus, minus)
        for m, q, kappa in c.learn:
            self.b_due += kappa * np.cross(s[m], self.d[q])
        total = np.vectorize(clip)(self.z + opened[:, None] * self.f)
        self.d = np.vectorize(signed)(total, INNOVATION)
        self.z = total - INNOVATION * self.d
        for i in range(3):
            taken = c.take[i].astype(int).T @ s[:, i] + c.read[i] * n_a[i]
            self.f[:, i] = [
                clip(keep(f, d) + t) for f, d, t in zip(self.f[:, i], c.levels[3], taken, strict=True)
            ]

    def products(self, n_w, plus, minus):
        """Sums over coincidence neurons: each spikes if both its inputs do, with its digit's weight."""
        found = np.zeros(plus.shape, int)
        quantum = ONE // 1024 // self.steps
        for i in range(3):
            for j, k, sign in (((i + 1) % 3, (i + 2) % 3, 1), ((i + 2) % 3, (i + 1) % 3, -1)):
                for power, digit in enumerate(digits(n_w[j], ANGLE_DIGITS)):
                    for of_digit, way in ((digit > 0, 1), (digit < 0, -1)):
                        for of_vector, other in ((plus[:, k], 1), (minus[:, k], -1)):
                            spikes = (of_digit.astype(int) + of_vector.astype(int)) >= 2
                            found[:, i] += sign * way * other * quantum * 3**power * spikes
        return found


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
        for name, value in (
            ("x", plain.x),
            ("y", plain.y),
            ("z", plain.z),
            ("gate", plain.g),
            ("felt", plain.h),
        ):
            axes_first = value.T if name in ("x", "y", "z") else value
            np.testing.assert_array_equal(state[name], axes_first.ravel(), name)
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


# --- as an estimator ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    from quadsim.dataset import generate, open_dataset
    from quadsim.flight.recipe import load_recipe

    path = tmp_path_factory.mktemp("circuit") / "flights.zarr"
    data = open_dataset(generate(load_recipe("hummingbird"), 2, 30.0, path, seed=12, workers=1))
    assert (data["valid_steps"] == data.sizes["time"]).all()
    return (
        data["gyro"].to_numpy().astype(float),
        data["accel"].to_numpy().astype(float),
        data["quat"].to_numpy(),
    )


def test_spikes_cost_little(flight):
    gyro, accel, quat = flight
    up = quat_rotate_inverse(quat.astype(float), np.broadcast_to([0, 0, 1.0], gyro.shape))
    errors = {}
    for name in NAMES:
        est = create(name, weights=SHIPPED)
        est.reset(len(gyro))
        errors[name] = inclination_deg(est.outputs(gyro, accel) + LEVEL, up)[:, 1000:].mean()
    assert errors["att-rnn"] < 4
    assert abs(errors["att-snn"] - errors["att-rnn"]) < 0.3


@pytest.mark.parametrize("name", NAMES)
def test_an_absurd_sample_is_refused_and_half_a_second_without_samples_is_forgotten(flight, name):
    gyro, accel, quat = flight
    up = quat_rotate_inverse(quat.astype(float), np.broadcast_to([0, 0, 1.0], gyro.shape))
    absurd, lost = (gyro.copy(), accel.copy()), (gyro.copy(), accel.copy())
    absurd[0][:, 2000], absurd[1][:, 2000] = 1e30, -1e30
    for each in lost:
        each[:, 2000:2100] = np.nan
    est = create(name, weights=SHIPPED)
    errors = []
    for g, a in ((gyro, accel), absurd, lost):
        est.reset(len(g))
        errors.append(inclination_deg(est.outputs(g, a) + LEVEL, up)[:, 4800:].mean())
        assert est.skipped[0] == (0, 1, 100)[len(errors) - 1]
    assert errors[1] == pytest.approx(errors[0], abs=0.5)
    assert errors[2] == pytest.approx(errors[0], abs=1.5)


def test_a_silent_output_is_level():
    est = NetworkEstimator(Silent(), RATE_HZ)
    gyro, accel = samples(2, 50)
    gyro[0, 3] = np.nan
    est.reset(2)
    assert not est.sequence(gyro, accel).any()
    assert est.skipped.tolist() == [1, 0]


def test_a_resting_imu_stays_level():
    gyro, accel = simulate_imu(
        load_imu("adis16448"),
        np.zeros((1, 4000, 3)),
        np.tile([0, 0, 9.81], (1, 4000, 1)),
        rate_hz=200.0,
        seed=0,
    )
    for name in NAMES:
        assert np.degrees(np.abs(create(name, weights=SHIPPED).sequence(gyro, accel))[0, 1000:]).max() < 4


# --- files ----------------------------------------------------------------------------------------------


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
    with pytest.raises(ValueError, match="not a safetensors file of a circuit"):
        load_circuit(tmp_path / "x.safetensors")
    with pytest.raises(ValueError, match="not a circuit"):
        load_circuit("assets/weights/att-snn-paper.safetensors")
    with pytest.raises(FileNotFoundError, match="no such file of a circuit"):
        load_circuit(tmp_path / "none.safetensors")
    with pytest.raises(ValueError, match="the circuit is for 200 Hz, not for 100 Hz"):
        create(SHIPPED, 100.0)


# --- in floats ------------------------------------------------------------------------------------------


def plain_floats(p: Parameters, gyro, accel, again):
    """The equations of `estimators.circuit.parameters`, an Euler step per sample, in float64."""
    dt, v = 1 / RATE_HZ, len(p.start)
    axes = [0, 0, 1]
    x, b, u, smooth = np.zeros((v, 3)), np.zeros(3), p.onset.copy(), np.zeros((3, 3))
    x[:, 2] = p.start
    e, most = np.zeros((len(p.level), 3)), np.radians(5.595)
    outputs = []
    for rate, force, resumes in zip(gyro, accel / GRAVITY, again, strict=True):
        target = np.array([force - [0, 0, 1], rate / 4, force - x[0]])
        smooth += dt / 0.05 * (target - smooth)
        felt = np.minimum(np.abs(smooth), 1)
        z = np.array([felt[0, :2].sum(), felt[0, 2], felt[1, :2].sum(), felt[1, 2], felt[2].sum()])
        u += resumes * p.resume
        u += dt / p.tau * (p.gate @ z - u)
        r = np.clip(u + p.level, 0, 1)
        raw = np.stack([p.take[:, k] @ x[:, i] + p.read[:, k] * force[i] for i, k in enumerate(axes)], 1)
        e += (1 - np.exp(-dt / 0.025)) * (raw - e)
        d = np.clip(r[:, None] * np.clip(e, -2, 2), -1, 1)
        angle = (rate - np.clip(b, -most, most)) * dt
        cross = np.cross(angle, x)
        change = -cross + np.cross(angle, cross) / 2
        for i, k in enumerate(axes):
            change[:, i] += dt * (p.mix[k] @ x[:, i] + p.pull[k] * force[i] + p.give[:, k].T @ d[:, i])
        b = b + dt * sum(kappa * np.cross(x[m], d[q]) for kappa, (m, q) in zip(p.learn, p.pairs, strict=True))
        b = np.clip(b, -2 * most, 2 * most)
        x = x + change
        outputs.append([*x[1], *b])
    return np.array(outputs)


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
