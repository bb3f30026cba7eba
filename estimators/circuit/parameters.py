"""Parameters of the circuit that tracks rotations: initial values, and conversion to integers.

The direction of gravity in body axes, g, obeys ġ = -ω × g + (a / 9.81 - g) / τ, a first-order low-pass of the
specific force a in a frame that does not rotate. The circuit has V vectors x_m, which all rotate in this way
and mix linearly, and Q innovations e_q. A gate passes the share r_q of an innovation. The inputs of the gates
are forces, rates, and the difference between force and first vector.

    ẋ_m = -(ω - clip(b, ±R)) × x_m + Σ_n A_mn x_n + B_m a + Σ_q K_qm d_q
    τ_e ė_q = Σ_n P_qn x_n + R_q a - e_q,   d_q = clip(r_q clip(e_q, ±2), ±1)
    τ_q u̇_q = W_q z - u_q,   r_q = clip(u_q + c_q, 0, 1)
    ḃ = Σ_p κ_p (x_p × d_p), b within ±2 R

Here, a is in units of 9.81 m/s² and R = 5.6 °/s. The weights are scalars, equal for x and y and different for
z, so that a rotation of the inputs about z rotates the estimate. The second vector is the world's z axis in
body axes, and b is the gyroscope bias, as in Mahony et al. 2008, "Nonlinear complementary filters on the
special orthogonal group".
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .circuit_records import BIAS_BITS, BIAS_RATE, FORCE, INNOVATION, ONE, TURN_RATE, Circuit

Array = NDArray[np.float64]
RATE_HZ = 200.0
GRAVITY = 9.81
"""Specific force of the value 1.0 [m/s²]."""
OUTPUT = 1
"""Index of the vector that is the output."""
FELT = 5
"""Inputs of a gate: |a_x| + |a_y|, |a_z - 1|, |ω_x| + |ω_y|, |ω_z| and the sum of |a - x_0| over the axes.
Each axis is smoothed over `FELT_S` and clipped to 1; rates are in units of `FELT_RATE`."""
FELT_S = 0.05
FELT_RATE = 4.0
"""Body rate of a gate input of 1.0 [rad/s]."""
SLOWEST, SLOW, FAST = (4096 / (k * 800) for k in (1, 3, 17))
"""Time constants of the gates, 5.1, 1.7 and 0.3 s, as decays of the chip with four steps per sample."""
SMOOTH_S = 0.025
"""Time constant of innovations, τ_e, which smooths their spikes [s]."""
TAU_S = 1.5
"""Time constant of the correction by the specific force before training [s]."""


class Parameters(NamedTuple):
    """Parameters of the circuit in floats; axes of length 2 are horizontal and vertical."""

    mix: Array  #: A (2, V, V) [1/s]
    pull: Array  #: B (2, V) [1/s]
    give: Array  #: K (Q, 2, V) [1/s]
    take: Array  #: P (Q, 2, V)
    read: Array  #: R (Q, 2)
    learn: Array  #: κ (pairs,) [rad/s²]
    gate: Array  #: W (Q, 5)
    level: Array  #: c (Q,)
    onset: Array  #: u at the start (Q,)
    resume: Array  #: what u gets when readings resume after a gap (Q,)
    tau: Array  #: (Q,) [s]
    pairs: NDArray[np.int64]  #: vector and innovation of each product for the bias (pairs, 2)
    start: Array  #: z of each vector at the start (V,)
    scale: Array  #: length of each vector for which its neurons spike in every step (V,)


LEARNT = ("mix", "pull", "give", "take", "read", "learn", "gate", "level", "onset", "resume")
"""Parameters that training changes."""


def circuit_shapes(vectors: int, gates: int, pairs: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of `Parameters`, by name."""
    v, q = vectors, gates
    return {
        "mix": (2, v, v), "pull": (2, v), "give": (q, 2, v), "take": (q, 2, v), "read": (q, 2),
        "learn": (pairs,), "gate": (q, FELT), "level": (q,), "onset": (q,), "resume": (q,), "tau": (q,),
        "pairs": (pairs, 2), "start": (v,), "scale": (v,),
    }  # fmt: skip


def untrained(vectors: int = 4, gates: int = 8, seed: int = 0, weight_noise: float = 0.0) -> Parameters:
    """Return the initial circuit: two low-passes of gravity, fast at the start and slow later.

    Args:
        vectors: V, at least 4.
        gates: Q, at least 8.
        seed: Seed of the noise.
        weight_noise: Standard deviation of noise that is added to the weights, so that units differ before
            training, relative to 0.01 /s.
    """
    rng = np.random.default_rng(seed)
    shapes = circuit_shapes(vectors, gates, pairs=1)
    values: dict[str, Any] = {name: np.zeros(shape) for name, shape in shapes.items()}
    values |= {"pairs": np.array([[OUTPUT, 6]]), "start": np.ones(vectors), "scale": np.ones(vectors)}
    p = Parameters(**values)
    p.learn[:] = 0.0075
    p.tau[0::2], p.tau[1::2] = FAST, SLOW
    p.tau[:8] = SLOW, SLOW, FAST, FAST, FAST, FAST, SLOWEST, FAST
    p.start[2] = 0
    p.mix[:] += 0.01 * weight_noise * rng.standard_normal(p.mix.shape)
    p.give[:] += 0.01 * weight_noise * rng.standard_normal(p.give.shape)
    p.take[:] += 0.05 * weight_noise * rng.standard_normal(p.take.shape)
    p.read[:] += 0.05 * weight_noise * rng.standard_normal(p.read.shape)
    p.gate[8:] = 0.1 * weight_noise * rng.standard_normal(p.gate[8:].shape)
    p.level[8:] = 0.4
    # the first vector follows the force; the third has what the force is in excess of it, as a velocity has
    p.mix[:, 0, 0] -= 1 / TAU_S
    p.mix[:, 2, 0] -= 1.0
    p.mix[:, 2, 2] -= 0.5
    p.pull[:, [0, 2]] = 1 / TAU_S, 1.0
    for m, tau in zip(range(3, vectors), (3.0, 0.3, 1.0, 8.0, 0.7, 2.0), strict=False):
        p.mix[:, m, m] -= 1 / tau
        p.pull[:, m] = 1 / tau
    # what is read is pulled to the first vector under large forces, else to a slower one; both fast at first
    p.give[[0, 1, 3], :, OUTPUT] = np.array([1 / TAU_S, 1.0, 8.0])[:, None]
    p.take[[0, 1, 3], :, OUTPUT] = -1.0
    p.take[[0, 3], :, 0] = p.take[1, :, 3] = 1.0
    p.give[2, :, 0], p.take[2, :, 0], p.read[2] = 8.0, -1.0, 1.0
    p.gate[0, 0], p.level[0], p.gate[1, 0], p.level[1] = 1.2, -0.2, -1.2, 1.2
    p.onset[[2, 3]] = p.resume[[2, 3]] = 1.0
    p.gate[4, 2], p.gate[5, 1] = 0.7, 1.0
    # the bias is learnt from the pull, as far as it is small, less where the force surprises
    p.give[6] = p.take[6] = p.read[6] = 0.0
    p.take[6, :, 0], p.take[6, :, OUTPUT] = 4.0, -4.0
    p.gate[6, 4], p.level[6], p.level[7] = -0.3, 0.8, 0.4
    return p


def quantised(p: Parameters, steps: int) -> Circuit:
    """Convert the circuit to the chip's integers, with this many steps per sample."""
    h = 1 / (RATE_HZ * steps)
    s = p.scale
    felt = round(4096 * h / FELT_S)
    smooth = round(4096 * h / SMOOTH_S)
    decays = np.maximum(1, np.rint(4096 * h / p.tau)).astype(np.int64)
    sense = felt * np.array([FORCE, TURN_RATE / FELT_RATE, s[0], 1.0]) * 64
    kappa = _weights(p.learn * h * s[p.pairs[:, 0]] / BIAS_RATE * (1 << BIAS_BITS))
    return Circuit(
        mix=_weights(_axes((p.mix * h * s / s[:, None]).swapaxes(1, 2)) * ONE),
        pull=_weights(_axes(p.pull * h / s) * FORCE * ONE),
        give=_weights(_axes(p.give.swapaxes(0, 1) * h / s) * ONE),
        take=_weights(_axes((p.take * s).transpose(1, 2, 0)) * smooth / 4096 * INNOVATION),
        read=_weights(_axes(p.read.T) * FORCE * smooth / 4096 * INNOVATION),
        gate=_weights(p.gate * decays[:, None] / 4096 * ONE),
        levels=np.stack(
            [
                _whole(p.level * ONE),
                _whole(p.onset * ONE),
                decays,
                np.full_like(decays, smooth),
                _weights(p.resume * ONE),
            ]
        ).astype(np.int32),
        sense=np.array([felt, *_weights(sense)], np.int32),
        learn=np.column_stack([p.pairs, kappa]).astype(np.int32),
        start=_whole(p.start / s * ONE),
    )


def _axes(values: Array) -> Array:
    """Expand horizontal and vertical to x, y and z."""
    return values[[0, 0, 1]]


def _whole(values: Array) -> NDArray[np.int32]:
    return np.rint(values).astype(np.int32)


def _weights(values: Array) -> NDArray[np.int32]:
    """Return the nearest weights of the chip: even mantissas up to 254, times 2^(6 + e) with e ≥ -8."""
    _, exponent = np.frexp(np.abs(values))
    unit = np.exp2(np.maximum(exponent - 8, -2).astype(np.float64)) * 2
    mantissa = np.minimum(np.rint(np.abs(values) / unit), 127)
    return _whole(np.sign(values) * mantissa * unit)
