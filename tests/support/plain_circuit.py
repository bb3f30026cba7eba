"""The circuit in plain Python, neuron by neuron, and in floats: the references of the compiled kernels."""

import numpy as np

from estimators.circuit.circuit_records import ANGLE_DIGITS, INNOVATION, ONE, RING
from estimators.circuit.parameters import GRAVITY, RATE_HZ, Parameters


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
    return np.sign(x) * (np.abs(x) * (4096 - d) >> 12)


def clip(x):
    return np.clip(x, 1 - 2**23, 2**23 - 1)


def signed(v, one):
    return (v > one // 2).astype(int) - (v < -(one // 2))


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
        soma = clip(self.y + self.x)
        s = signed(soma, ONE)
        self.y = soma - ONE * s
        soma = clip(self.b_soma + self.b)
        self.b_spikes = signed(soma, 2**22)
        self.b_soma = soma - 2**22 * self.b_spikes
        self.b, self.b_due = clip(self.b + self.b_due), np.zeros(3, int)
        opened = self.g + c.levels[0] > ring
        fires = 4 * np.abs(self.h) > ring
        heard = [fires[0, :2].sum(), fires[0, 2], fires[1, :2].sum(), fires[1, 2], fires[2].sum()]
        self.g = clip(keep(self.g, c.levels[2].astype(int)) + c.gate.astype(int) @ heard)
        felt, to_force, to_turn, to_first, still = map(int, c.sense)
        push = [to_force * n_a - [0, 0, still], to_turn * n_w, to_force * n_a - to_first * s[0]]
        self.h = clip(keep(self.h, felt) + push)
        turned = self.coincident
        for i in range(3):
            self.x[:, i] += c.mix[i].astype(int).T @ s[:, i] + c.pull[i] * n_a[i] - turned[:, i]
            self.x[:, i] += c.give[i].astype(int).T @ self.d[:, i]
        self.x = clip(self.x)
        self.y = clip(self.y - turned * 3 // 2)
        self.coincident = self.products(n_w, s > 0, s < 0)
        for m, q, kappa in c.learn:
            self.b_due += kappa * np.cross(s[m], self.d[q])
        total = clip(self.z + opened[:, None] * self.f)
        self.d = signed(total, INNOVATION)
        self.z = total - INNOVATION * self.d
        for i in range(3):
            taken = c.take[i].astype(int).T @ s[:, i] + c.read[i] * n_a[i]
            self.f[:, i] = clip(keep(self.f[:, i], c.levels[3].astype(int)) + taken)

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


def plain_floats(p: Parameters, gyro, accel, again):
    """The equations of `estimators.circuit.parameters`, an Euler step a sample, in float64."""
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
