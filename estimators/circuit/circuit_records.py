"""Records and units of the spiking circuit: parameters, state and spikes of one step.

A value of 1.0 is 2^20 units of a membrane. Compiled code receives a circuit and the state of a copy as one
row of numbers each, which `circuit_of` and `state_of` convert to records.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.compiled import njit

from ..networks.encoder import ENCODED

Int32s = NDArray[np.int32]

ONE_BITS = 20
ONE = 1 << ONE_BITS
"""Membrane units of the value 1.0."""
INNOVATION_BITS = 22
INNOVATION = 1 << INNOVATION_BITS
"""Membrane units of an innovation of 1.0; the range of a membrane is twice that."""
BIAS_BITS = 22
"""Base-2 logarithm of the membrane units of a bias that spikes in every step; the range of a membrane is
twice that."""
FELT_BITS = 18
FELT = 1 << FELT_BITS
"""Units of the value 1.0 of a gate's inputs, so that 32 g and 128 rad/s fit in 24 bits."""
ANGLE_DIGITS, FORCE_DIGITS = 5, 4
"""Balanced ternary digits of the encoders' spikes, with 1, 3, 9, 27 and 81 quanta."""
ANGLE_MAX, FORCE_MAX = (3**ANGLE_DIGITS - 1) // 2, (3**FORCE_DIGITS - 1) // 2
"""Largest number of quanta in a step, for 23.6 rad/s and 98 m/s²; the rest is sent in later steps."""
ANGLE_UNITS, FORCE_UNITS, BIAS_UNITS = 128, 256, 64
"""Encoder units of a quantum of angle, of a quantum of force, and of the angle that a spike of the bias
subtracts."""
LATER = 1 << 14
"""Largest amount that the encoder can postpone, in encoder units; 128 quanta of angle."""
TURN_BITS = 10
"""A quantum of angle is 2^-10 rad / S, with S steps per sample."""
FORCE = 0.25
"""Specific force of a quantum [9.81 m/s²]."""
TURN_RATE = 2.0**-TURN_BITS * 200
"""Body rate that gives one quantum of angle per step, for any number of steps per sample [rad/s]."""
BIAS_RATE = TURN_RATE * BIAS_UNITS / ANGLE_UNITS
"""Bias that spikes in every step, which is the largest that can be subtracted from a rate: 5.6 °/s, in
rad/s."""
LEAD = 3
"""Lead of a vector's spikes during a rotation, in half steps. A rotation reaches the vector one and a half
steps after the middle of the spikes that it multiplied; the lead keeps the length of the vector constant."""
RINGS = 16, 15
"""Numbers of neurons in two rings. In each ring, the neurons spike in turn, one per step. Both rings add to
the thresholds of gates and gate inputs: the first in steps of 1/16, the second in fifteenths of that."""


def _thresholds():
    """Return the sum of both rings in each of 240 steps, in which each sum occurs once."""
    first, second = (np.argsort(np.argsort(np.arange(n) * (5**0.5 - 1) / 2 % 1)) for n in RINGS)
    fine = np.rint((second + 0.5) * 128 / RINGS[1]) * (ONE >> 11)
    t = np.arange(RINGS[0] * RINGS[1])
    return (first[t % RINGS[0]] * (ONE >> 4) + fine[t % RINGS[1]]).astype(np.int32)


RING = _thresholds()
_HALVES = (3 ** np.arange(ANGLE_DIGITS) - 1) // 2
DIGITS = ((np.arange(ANGLE_MAX + 1)[:, None] + _HALVES) // 3 ** np.arange(ANGLE_DIGITS) % 3 > 0).sum(1)
"""Number of non-zero balanced ternary digits of each number."""
EVENTS = ("angles", "vectors", "coincidences", "innovations", "gates", "felt", "bias", "learning", "forces")
"""Kinds of unsigned spikes that a circuit counts."""


class Circuit(NamedTuple):
    """Integer parameters, in membrane units per spike.

    The axes of `mix` to `read` are body axis, source, target.
    """

    mix: Int32s  #: A, from vectors to vectors (3, V, V)
    pull: Int32s  #: B, of vectors by a quantum of force (3, V)
    give: Int32s  #: K, from innovations that passed to vectors (3, Q, V)
    take: Int32s  #: P, from vectors to innovations (3, V, Q)
    read: Int32s  #: R, of innovations by a quantum of force (3, Q)
    gate: Int32s  #: W, of gates by what is felt (Q, 5)
    levels: Int32s
    """For each gate: bias, start, decay, decay of its innovation, and gain when readings resume (5, Q)."""
    sense: Int32s  #: decay of what is felt, weights of force, turn and first vector, bias of z (5,)
    learn: Int32s  #: vector, gate and κ of each product for the gyroscope's bias (pairs, 3)
    start: Int32s  #: z of each vector at the start (V,)


class CircuitState(NamedTuple):
    """State of a copy between steps, as views of its row of numbers."""

    angle: Int32s  #: of the gyroscope, that no spike has yet represented (3,)
    force: Int32s  #: of the accelerometer (3,)
    x: Int32s  #: vectors (3, V)
    y: Int32s  #: their somas (3, V)
    turned: Int32s  #: what coincidences of the step before take from them (3, V)
    drive: Int32s  #: f, innovations, smoothed (3, Q)
    z: Int32s  #: their somas (3, Q)
    passed: Int32s  #: d, their spikes (3, Q)
    felt: Int32s  #: h: force, rate and surprise (3, 3)
    gate: Int32s  #: g (Q,)
    bias: Int32s  #: b, its soma, its spikes, and what it gets next (4, 3)
    ring: Int32s  #: steps since the start, counted around the ring from 1; 0 before the first (1,)
    events: Int32s  #: spikes since the start, as `EVENTS` (9,)


class Spikes(NamedTuple):
    """Spikes of one step."""

    vectors: Int32s  #: s (3, V)
    angle: Int32s  #: n_ω (3,)
    force: Int32s  #: n_a (3,)
    heard: Int32s  #: ρ (5,)
    gates: Int32s  #: γ (Q,)


@njit
def no_spikes(vectors, gates):
    """Return empty arrays for the spikes of a step."""
    return Spikes(
        np.zeros((3, vectors), np.int32),
        np.zeros(3, np.int32),
        np.zeros(3, np.int32),
        np.zeros(5, np.int32),
        np.zeros(gates, np.int32),
    )


@njit(inline="always")
def state_of(row, vectors, gates):
    """Return the `CircuitState` of a row of numbers, which begins with the encoder's state."""
    v, q = 3 * vectors, 3 * gates
    at = ENCODED + 6
    x, y, turned = row[at : at + v], row[at + v : at + 2 * v], row[at + 2 * v : at + 3 * v]
    at += 3 * v
    drive, z, passed = row[at : at + q], row[at + q : at + 2 * q], row[at + 2 * q : at + 3 * q]
    at += 3 * q
    felt, gate = row[at : at + 9], row[at + 9 : at + 9 + gates]
    at += 9 + gates
    return CircuitState(
        row[ENCODED : ENCODED + 3],
        row[ENCODED + 3 : ENCODED + 6],
        x.reshape(3, vectors),
        y.reshape(3, vectors),
        turned.reshape(3, vectors),
        drive.reshape(3, gates),
        z.reshape(3, gates),
        passed.reshape(3, gates),
        felt.reshape(3, 3),
        gate,
        row[at : at + 12].reshape(4, 3),
        row[at + 12 : at + 13],
        row[at + 13 :],
    )


@njit(inline="always")
def circuit_of(row, vectors, gates):
    """Return the `Circuit` of a row of numbers."""
    v, q = 3 * vectors, 3 * gates
    mix, row = row[: v * vectors], row[v * vectors :]
    pull, row = row[:v], row[v:]
    give, row = row[: q * vectors], row[q * vectors :]
    take, row = row[: q * vectors], row[q * vectors :]
    read, row = row[:q], row[q:]
    gate, row = row[: 5 * gates], row[5 * gates :]
    levels, row = row[: 5 * gates], row[5 * gates :]
    return Circuit(
        mix.reshape(3, vectors, vectors),
        pull.reshape(3, vectors),
        give.reshape(3, gates, vectors),
        take.reshape(3, vectors, gates),
        read.reshape(3, gates),
        gate.reshape(gates, 5),
        levels.reshape(5, gates),
        row[:5],
        row[5:-vectors].reshape(-1, 3),
        row[-vectors:],
    )
