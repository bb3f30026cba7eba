"""The neurons of a circuit on the chip."""

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
    """Connections that enter them, with weights other than 0."""


def populations(circuit: Circuit) -> list[Population]:
    """The circuit's neurons by kind, from the encoders' spikes to the bias.

    A signed spike is that of one of two neurons. A vector has a compartment for its state on each axis, and
    two somas; a product has a coincidence neuron for each two signs, digit, axis and other axis.
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
    """Cores that the circuit takes, filled with one population after the other.

    Raises:
        ValueError: More than a chip has.
    """
    cores = -(-sum(each.compartments for each in populations(circuit)) // LIMITS["compartments"])
    if cores > CORES:
        raise ValueError(f"the circuit needs {cores} cores, a chip has {CORES}: {cores - CORES} too many")
    return cores
