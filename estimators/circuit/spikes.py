"""Att-SNN: the spiking circuit in the integers of the chip.

A step lasts 1 / (200 S) s, with S steps per sample. Membranes and currents have 24 bits including the sign,
and 1.0 is 2^20 units. Spikes are signed here; on the chip, two neurons with mirrored synapses represent a
signed spike. Index t is the value after step t. Every connection delivers after one step:

    n_ω, n_a  spikes of the encoders: angles in quanta of 2^-10 / S rad, forces in quanta of 9.81 / 4 m/s²
    vectors   s[t] = sign of y if |y| > 2^19, else 0, with y = y[t-1] + x[t-1]
              y[t] = y - 2^20 s[t] - 3/2 turned[t-1]
              x[t] = x[t-1] + A s[t] + B n_a[t] + Σ_q K_q d_q[t-1] - turned[t-1]
              turned[t] = (n_ω × s)[t] / (2^10 S)
    innovations
              d_q[t] = sign of z if |z| > 2^21, else 0, with z = z_q[t-1] + γ_q[t] f_q[t-1]
              z_q[t] = z - 2^22 d_q[t]
              f_q[t] = D(f_q[t-1], smooth) + P_q s[t] + R_q n_a[t]
    gates     γ_q[t] = 1 if g_q[t-1] + c_q > ring[t], else 0
              g_q[t] = D(g_q[t-1], decay_q) + Σ_k W_qk ρ_k[t], and before the first step after a gap
              in the readings g_q gets the weight of a spike that the encoder sends then
    felt      ρ_k[t] = number of currents h of kind k with 4 |h[t-1]| > ring[t]
              h[t] = D(h[t-1], felt) + Σ of what is felt
    bias      b[t] = b[t-1] + Σ_p κ_p (s_p × d_p)[t-1], whose spikes the gyroscope's encoder takes away

with D(x, d) = sign(x) ((|x| (4096 - d)) >> 12); every membrane is clipped to ±(2^23 - 1). A product such as
n_ω × s is the sum of coincidence neurons, one for each two signs, axes and digit of n_ω: a spike of theirs
needs one of the gyroscope and one of the vector.

The circuit needs three features beyond leaky integrate-and-fire neurons. Vectors, innovations and the bias
are reset by subtraction. A gate joins f_q to z_q: the compartment passes f_q on in steps in which the gate
spikes. Finally, `ring` is a threshold that two rings of neurons, which spike in turn, add to gates and gate
inputs.
"""

from __future__ import annotations

import numpy as np

from quadsim.runs.compiled import njit

from ..loihi.neurons import STATE_MAX, decay
from ..networks.encoder import Scaling, encode_sample, encoder_fields, resumed
from .circuit_records import (
    ANGLE_MAX,
    ANGLE_UNITS,
    BIAS_BITS,
    BIAS_UNITS,
    DIGITS,
    EVENTS,
    FELT_BITS,
    FORCE_MAX,
    FORCE_UNITS,
    INNOVATION_BITS,
    LATER,
    LEAD,
    ONE,
    ONE_BITS,
    RING,
    TURN_BITS,
    Circuit,
    CircuitState,
    circuit_of,
    no_spikes,
    state_of,
)


class SpikingCircuit:
    """The circuit in the chip's integers; a `NetworkCore`.

    Args:
        scaling: Scaling of the readings.
        circuit: Parameters of the circuit.
        output: Index of the vector that is the output.
        steps: Steps per sample, 1, 2 or 4.
        unit: Length of the estimate at which the neurons of the vector spike in every step.
    """

    outputs = 3

    def __init__(self, scaling: Scaling, circuit: Circuit, output: int, steps: int, unit: float) -> None:
        vectors, gates = len(circuit.start), len(circuit.gate)
        sizes = [3, 3, *[3 * vectors] * 3, *[3 * gates] * 3, 9, gates, 12, 1, len(EVENTS)]
        kept = zip(CircuitState._fields, sizes, strict=True)
        self.state = np.dtype([*encoder_fields(np.int32), *((name, np.int32, size) for name, size in kept)])
        settings = np.array([*np.ravel(scaling), steps, output, unit / ONE, vectors, gates])
        self.arrays = settings, np.concatenate([np.ravel(each) for each in circuit])
        self.kernel = run_circuit


@njit(cache=True, nogil=True)
def run_circuit(gyro, accel, set_points, settings, numbers, states, out, fired=None):
    """Run n copies over sequences and update their states, with the signature of `NetworkCore.kernel`.

    The spikes of every step are written to `fired` (n, T steps, 3 V + 3 Q + Q + 3), if given: vectors by
    axis, innovations by axis, gates and bias. Only spikes of gates are unsigned.
    """
    scaling = Scaling(settings[:6], settings[6:12])
    steps, output, unit = int(settings[12]), int(settings[13]), settings[14]
    vectors, gates = int(settings[15]), int(settings[16])
    circuit, spikes = circuit_of(numbers, vectors, gates), no_spikes(vectors, gates)
    passed, opened, learnt = 3 * vectors, 3 * (vectors + gates), 3 * vectors + 4 * gates
    for copy in range(states.shape[0]):
        row = states[copy]
        state = state_of(row, vectors, gates)
        if state.ring[0] == 0:
            for m in range(vectors):
                state.x[2, m] = circuit.start[m]
            for q in range(gates):
                state.gate[q] = circuit.levels[1, q]
        for t in range(gyro.shape[1] // 3):
            part = slice(3 * t, 3 * t + 3)
            _sense(gyro[copy, part], accel[copy, part], scaling, row, state, circuit)
            for k in range(steps):
                step_circuit(row, state, circuit, steps, spikes)
                if fired is not None:
                    now = fired[copy, t * steps + k]
                    now[:passed] = spikes.vectors.ravel()
                    now[passed:opened] = state.passed.ravel()
                    now[opened:learnt] = spikes.gates
                    now[learnt:] = state.bias[2]
            for i in range(3):
                out[copy, 3 * t + i] = state.x[i, output] * unit - (i == 2)


@njit(inline="always")
def _sense(gyro, accel, scaling, row, state, circuit):
    """Process one sample; the first one after a gap opens gates."""
    encode_sample(gyro, accel, scaling, row)
    if state.ring[0] and resumed(row):
        for q in range(circuit.levels.shape[1]):
            state.gate[q] = _clipped(state.gate[q] + circuit.levels[4, q])


@njit
def step_circuit(row, state, circuit, steps, spikes):
    """Run one of several steps per sample of a copy, and write `spikes`."""
    s, n_w, n_a, heard, opened = spikes
    state.ring[0] = state.ring[0] % RING.size + 1
    threshold = RING[state.ring[0] - 1]
    _encode(row, state, n_w, n_a)
    _fire(state, s)
    for q in range(opened.size):
        opened[q] = state.gate[q] + circuit.levels[0, q] > threshold
        state.events[4] += opened[q]
    _feel(state, circuit.sense, threshold, n_w, n_a, s, heard)
    _hear(state, circuit, heard)
    _advance(state, circuit, s, n_a)
    _turn(state, n_w, s, steps)
    _innovate(state, circuit, opened, s, n_a)


@njit(inline="always")
def _clipped(v):
    return np.int32(min(max(v, -STATE_MAX), STATE_MAX))


@njit(inline="always")
def _spike(v, bits):
    """Return the signed spike of a soma, which is reset by 2^bits."""
    half = 1 << (bits - 1)
    return np.int32(v > half) - np.int32(v < -half)


@njit(inline="always")
def _quanta(waiting, units, most):
    """Return the number of quanta to send, limited by the digits, and the remainder."""
    n = min(max((waiting + units // 2) // units, -most), most)
    return np.int32(n), np.int32(min(max(waiting - units * n, -LATER), LATER))


@njit(inline="always")
def _encode(row, state, n_w, n_a):
    """Compute the spikes of the encoders, on the host."""
    for i in range(3):
        unbiased = row[i] - BIAS_UNITS * state.bias[2, i]
        n_w[i], state.angle[i] = _quanta(state.angle[i] + unbiased, ANGLE_UNITS, ANGLE_MAX)
        n_a[i], state.force[i] = _quanta(state.force[i] + row[3 + i], FORCE_UNITS, FORCE_MAX)
        state.events[0] += DIGITS[abs(n_w[i])]
        state.events[8] += DIGITS[abs(n_a[i])]


@njit(inline="always")
def _fire(state, s):
    """Compute the spikes of the vectors and of the bias."""
    for i in range(3):
        for m in range(s.shape[1]):
            v = _clipped(state.y[i, m] + state.x[i, m])
            s[i, m] = _spike(v, ONE_BITS)
            state.y[i, m] = v - (s[i, m] << ONE_BITS)
            state.events[1] += abs(s[i, m])
    bias, soma, spikes, due = state.bias
    for i in range(3):
        v = _clipped(soma[i] + bias[i])
        spikes[i] = _spike(v, BIAS_BITS)
        soma[i] = v - (spikes[i] << BIAS_BITS)
        bias[i], due[i] = _clipped(bias[i] + due[i]), 0
        state.events[6] += abs(spikes[i])


@njit(inline="always")
def _feel(state, sense, threshold, n_w, n_a, s, heard):
    """Compute the spikes of the gate inputs, by kind, and then their currents."""
    heard[:] = 0
    for i in range(3):
        for k in range(3):
            spike = np.int32(abs(state.felt[k, i]) << (ONE_BITS - FELT_BITS) > threshold)
            heard[4 if k == 2 else 2 * k + (i == 2)] += spike
            state.events[5] += spike
        push = sense[1] * n_a[i]
        still = sense[4] if i == 2 else 0
        state.felt[0, i] = _clipped(decay(state.felt[0, i], sense[0]) + push - still)
        state.felt[1, i] = _clipped(decay(state.felt[1, i], sense[0]) + sense[2] * n_w[i])
        state.felt[2, i] = _clipped(decay(state.felt[2, i], sense[0]) + push - sense[3] * s[i, 0])


@njit(inline="always")
def _hear(state, circuit, heard):
    """Update the currents of the gates."""
    for q in range(circuit.gate.shape[0]):
        total = decay(state.gate[q], circuit.levels[2, q])
        for k in range(heard.size):
            total += circuit.gate[q, k] * heard[k]
        state.gate[q] = _clipped(total)


@njit(inline="always")
def _advance(state, circuit, s, n_a):
    """Update the vectors: mixing, corrections and rotation."""
    x, vectors, gates = state.x, s.shape[1], state.passed.shape[1]
    for i in range(3):
        for m in range(vectors):
            x[i, m] += circuit.pull[i, m] * n_a[i] - state.turned[i, m]
            state.y[i, m] = _clipped(state.y[i, m] - state.turned[i, m] * LEAD // 2)
        for n in range(vectors):
            if s[i, n]:
                for m in range(vectors):
                    x[i, m] += circuit.mix[i, n, m] * s[i, n]
        for q in range(gates):
            if state.passed[i, q]:
                for m in range(vectors):
                    x[i, m] += circuit.give[i, q, m] * state.passed[i, q]
        for m in range(vectors):
            x[i, m] = _clipped(x[i, m])


@njit(inline="always")
def _turn(state, n_w, s, steps):
    """Compute the coincidences of the gyroscope's spikes with those of the vectors."""
    weight = (ONE >> TURN_BITS) // steps
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        about_j, about_k = DIGITS[abs(n_w[j])], DIGITS[abs(n_w[k])]
        for m in range(s.shape[1]):
            state.turned[i, m] = (n_w[j] * s[k, m] - n_w[k] * s[j, m]) * weight
            state.events[2] += abs(s[k, m]) * about_j + abs(s[j, m]) * about_k


@njit(inline="always")
def _innovate(state, circuit, opened, s, n_a):
    """Update the bias, the spikes of the innovations, and their currents."""
    due, passed = state.bias[3], state.passed
    for p in range(circuit.learn.shape[0]):
        m, q, kappa = circuit.learn[p]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            there, back = s[j, m] * passed[k, q], s[k, m] * passed[j, q]
            due[i] += kappa * (there - back)
            state.events[7] += abs(there) + abs(back)
    for i in range(3):
        for q in range(opened.size):
            v = _clipped(state.z[i, q] + opened[q] * state.drive[i, q])
            spike = _spike(v, INNOVATION_BITS)
            passed[i, q], state.z[i, q] = spike, v - (spike << INNOVATION_BITS)
            state.events[3] += abs(spike)
            state.drive[i, q] = decay(state.drive[i, q], circuit.levels[3, q]) + circuit.read[i, q] * n_a[i]
        for m in range(s.shape[1]):
            if s[i, m]:
                for q in range(opened.size):
                    state.drive[i, q] += circuit.take[i, m, q] * s[i, m]
        for q in range(opened.size):
            state.drive[i, q] = _clipped(state.drive[i, q])
