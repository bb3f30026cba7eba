"""The spiking circuit as C99 for microcontrollers, bit-identical to the emulated chip.

The C interface and the encoding of readings are those of a network of layers.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.fingerprint import ASSETS

from ..circuit import circuit_records as records
from ..circuit.circuit_estimator import SCALING
from ..circuit.file import CircuitConfig
from ..circuit.parameters import LEARNT, OUTPUT, RATE_HZ, Parameters, quantised
from ..loihi.neurons import DECAY_ONE, STATE_MAX
from ..networks.layer_parameters import DECAY
from .c_source import ESTIMATOR, braces, encoder_values, write_sources

Ints = NDArray[np.integer]

DIRECTIONS = [0, 2]
"""Body axes whose weights are stored: a horizontal and the vertical one, because x and y have equal
weights."""
HEARD = np.array([2, 1, 2, 1, 3])
"""Largest number of spikes of each kind that a gate receives in a step."""

PART = re.compile(r"^#part (\w+)\n", re.MULTILINE)
"""Line of the template that is replaced by a part of the networks' template."""
PARTS = {
    "decay": ("/* Negative numbers are shifted", "/* Two's complement"),
    "readings": ("/* Size of a number", "void ${n}_reset"),
    "encode": ("void ${n}_encode", "static void step_outputs"),
}
"""First lines of these parts, and of the code after each."""


def write_circuit_c(folder: str | Path, config: CircuitConfig, p: Parameters) -> None:
    """Write `att_snn.h` and `.c` to a folder.

    Raises:
        ValueError: A number does not fit in 24 bits, or a sum does not fit in 32 bits.
    """
    circuit = quantised(p, config.steps_per_sample)
    _check(circuit)
    values = {
        "n": ESTIMATOR,
        "N": ESTIMATOR.upper(),
        "vectors": config.vectors,
        "gates": config.gates,
        "parameters": sum(getattr(p, name).size for name in LEARNT),
        "rate": f"{RATE_HZ:g}",
        "units": round(records.ONE / p.scale[OUTPUT]),
        "scale": repr(float(p.scale[OUTPUT] / records.ONE)),
        "steps": config.steps_per_sample,
        "output": OUTPUT,
        **encoder_values(SCALING),
        **_constants(),
        **_integers(circuit),
    }
    layers = (ASSETS / "c99" / "network.c").read_text(encoding="utf-8")

    def part(found: re.Match[str]) -> str:
        start, end = map(layers.index, PARTS[found[1]])
        return layers[start:end]

    write_sources(folder, "circuit", values, PART, part)


COPIED = (
    "ONE_BITS", "BIAS_BITS", "INNOVATION_BITS", "FELT_BITS", "ANGLE_MAX", "LATER", "BIAS_UNITS", "TURN_BITS",
    "LEAD",
)  # fmt: skip
"""Constants of all circuits with the same names in templates and code."""


def _constants() -> dict[str, int | str]:
    """Return the template values that all circuits have in common."""
    return {name.lower(): getattr(records, name) for name in COPIED} | {
        "angle_bits": records.ANGLE_UNITS.bit_length() - 1,
        "force_bits": records.FORCE_UNITS.bit_length() - 1,
        "force_quanta": records.FORCE_MAX,
        "ring_size": records.RING.size,
        "ring": braces(np.asarray(records.RING)),
    }


def _integers(circuit: records.Circuit) -> dict[str, int | str]:
    """Return weights, decays and initial values in the layout of the C code."""
    level, onset, decays, smooth, resume = circuit.levels.astype(np.int64)
    felt, force, turn, vector, still = circuit.sense.tolist()
    found: dict[str, int | str] = {
        "pull": braces(circuit.pull[DIRECTIONS]),
        "read": braces(circuit.read[DIRECTIONS]),
        "start": braces(circuit.start),
        "onset": braces(onset),
        "resume": braces(resume),
        "felt_keep": DECAY.in_c(felt),
        "drive_keep": DECAY.in_c(int(smooth[0])),
        "felt_force": force,
        "felt_turn": turn,
        "felt_vector": vector,
        "felt_still": still,
    }
    for name in ("mix", "give", "take"):
        weights = getattr(circuit, name)[DIRECTIONS].astype(np.int64)
        found[name], found[f"from_{name}"] = map(braces, _words(weights))
    rows = zip(level.tolist(), decays.tolist(), circuit.gate, strict=True)
    found["gate"] = "{\n" + ",\n".join(f"{{{c}, {DECAY.in_c(d)}, {braces(w)}}}" for c, d, w in rows) + "}"
    pairs = circuit.learn if len(circuit.learn) else np.zeros((1, 3), np.int32)  # C has no empty arrays
    return found | {"pairs": len(pairs), "learn": braces(pairs)}


def _words(weights: Ints) -> tuple[Ints, Ints]:
    """Return words of non-zero weights, (directions, sources, targets), and the bounds of each source."""
    directions, sources, _ = weights.shape
    targets = np.nonzero(weights)[2]
    ends = np.cumsum(np.count_nonzero(weights, axis=2)).reshape(directions, sources)
    starts = np.concatenate([[0], ends[:-1, -1]])[:, None]
    words = weights[weights != 0] * 256 + targets
    return words if len(words) else np.zeros(1, np.int64), np.concatenate([starts, ends], 1)


def _check(circuit: records.Circuit) -> None:
    """Check that no number of the circuit is too large for the C code, for any readings.

    Raises:
        ValueError: A number is too large.
    """
    c = records.Circuit(*(np.abs(part.astype(np.int64)) for part in circuit))
    decays = np.concatenate([circuit.levels[2:4].ravel(), circuit.sense[:1]])
    if np.any(decays < 1) or np.any(decays >= DECAY_ONE):
        raise ValueError("C99 needs time constants that are longer than a step")
    if max(part.max(initial=0) for part in c) > STATE_MAX:
        raise ValueError("C99 needs weights and initial values within 24 bits")
    turned = 2 * records.ANGLE_MAX << (records.ONE_BITS - records.TURN_BITS)
    sums = (
        c.mix.sum(1) + c.give.sum(1) + c.pull * records.FORCE_MAX + turned,
        c.take.sum(1) + c.read * records.FORCE_MAX,
        c.gate @ HEARD,
        c.sense[1:] * records.ANGLE_MAX + c.sense[3] + c.sense[4],
        2 * c.learn[:, 2].sum(keepdims=True),
    )
    if max(part.max(initial=0) for part in sums) + STATE_MAX >= 1 << 31:
        raise ValueError("C99 needs weights whose sums are within 32 bits")
