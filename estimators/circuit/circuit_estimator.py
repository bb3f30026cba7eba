"""The circuit as an estimator: att-snn and att-snn-loihi with spikes, att-rnn in floats."""

from __future__ import annotations

import numpy as np

from ..networks.encoder import ENCODER, INPUT_ONE, Array, Scaling, encode
from ..networks.network import NetworkEstimator
from ..networks.weights_file import READINGS
from .floats import FloatCircuit
from .on_chip import place
from .parameters import GRAVITY, OUTPUT, RATE_HZ, Parameters, quantised
from .spikes import SpikingCircuit

GYRO_RANGE = INPUT_ONE * 2.0**-17 * RATE_HZ
"""Body rate that gives an input of 1.0 [rad/s]; an integer input is a multiple of 2^-17 rad per sample."""
SCALING = Scaling(np.zeros(6), INPUT_ONE / np.array([GYRO_RANGE] * 3 + [GRAVITY] * 3))


def circuit_estimator(name: str, p: Parameters, steps: int = 4, rate_hz: float = RATE_HZ) -> NetworkEstimator:
    """Make an estimator that runs a circuit.

    Args:
        name: "att-snn", "att-snn-loihi" or "att-rnn".
        p: Parameters of the circuit.
        steps: Steps of the chip per sample, 1, 2 or 4.
        rate_hz: Samples per second.

    Raises:
        ValueError: The sample rate is not that of the circuit, or the circuit does not fit the chip
            ("att-snn-loihi").
    """
    if not np.isclose(rate_hz, RATE_HZ):
        raise ValueError(f"{name}: the circuit is for {RATE_HZ:g} Hz, not for {rate_hz:g} Hz")
    if name == "att-rnn":
        return NetworkEstimator(FloatCircuit(SCALING, p), RATE_HZ)
    circuit = quantised(p, steps)
    if name == "att-snn-loihi":
        place(circuit)
    return NetworkEstimator(SpikingCircuit(SCALING, circuit, OUTPUT, steps, p.scale[OUTPUT]), RATE_HZ)


class Silent:
    """A `NetworkCore` with a silenced output: the estimate is always level."""

    outputs, state, arrays = 3, ENCODER, ()

    @staticmethod
    def kernel(gyro: Array, accel: Array, set_points: Array, states: Array, out: Array) -> None:
        """Count missing samples, with the signature of `NetworkCore.kernel`."""
        out[:] = 0
        readings = (each.reshape(len(each), -1, 3) for each in (gyro, accel))
        encode(*readings, SCALING, states, np.empty((len(gyro), gyro.shape[1] // 3, READINGS)))
