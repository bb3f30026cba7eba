"""Populations of a circuit on the chip, and their cores."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..loihi.chip import CORES, LIMITS
from .circuit_records import ANGLE_DIGITS, FORCE_DIGITS, RINGS, Circuit

SIGNS, AXES = 2, 3


class Population(NamedTuple):
    """Neurons of one kind."""

    name: str
    neurons: int
    compartments: int
    synapses: int
    """Number of non-zero incoming connections."""


def populations(circuit: Circuit) -> list[Population]:
    """Return the populations of the circuit, from the encoders' spikes to the bias.

    Two neurons represent a signed spike. Each axis of a vector has a compartment for the state and two somas.
    A product has one coincidence neuron per pair of signs, digit, and pair of axes.
    """
    vectors, gates, pairs = len(circuit.start), len(circuit.gate), len(circuit.learn)
    angles, forces = SIGNS * ANGLE_DIGITS, SIGNS * FORCE_DIGITS
    coincidences = vectors * AXES * 2 * SIGNS * angles
    mixed = SIGNS * int(np.count_nonzero(circuit.mix) + np.count_nonzero(circuit.give))
    pulled = forces * int(np.count_nonzero(circuit.pull))
    asked = SIGNS * (
        SIGNS * int(np.count_nonzero(circuit.take)) + forces * int(np.count_nonzero(circuit.read))
    )
    felt = SIGNS * 3 * AXES
    felt_synapses = SIGNS * AXES * (2 * forces + angles + SIGNS)
    learning = pairs * AXES * 2 * SIGNS * SIGNS
    ring = sum(RINGS)
    return [
        Population(
            "vectors", vectors * AXES * SIGNS, vectors * AXES * (1 + SIGNS), mixed + pulled + 2 * coincidences
        ),
        Population("coincidences", coincidences, coincidences, 2 * coincidences),
        Population("innovations", gates * AXES * SIGNS, gates * AXES * (2 + SIGNS), asked),
        Population("gates", gates, gates, gates * ring + 4 * int(np.count_nonzero(circuit.gate))),
        Population("what is felt", felt, felt, felt_synapses + felt * ring),
        Population("rings", ring, ring, ring),
        Population("bias", AXES * SIGNS + learning, AXES * (1 + SIGNS) + learning, 3 * learning),
    ]


def place(circuit: Circuit) -> int:
    """Return the number of cores for the circuit, filled with one population after the other.

    Raises:
        ValueError: The circuit needs more cores than a chip has.
    """
    cores = -(-sum(each.compartments for each in populations(circuit)) // LIMITS["compartments"])
    if cores > CORES:
        raise ValueError(f"the circuit needs {cores} cores, a chip has {CORES}: {cores - CORES} too many")
    return cores
