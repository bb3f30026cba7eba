"""A small spiking controller, networks with random weights, and signals for them."""

import numpy as np

from estimators.networks.layer_parameters import EXPONENTS
from estimators.networks.weights_file import NetworkConfig, SetPointScaling, tensor_shapes
from quadsim.vehicle import GRAVITY

CONFIG = NetworkConfig(
    model="att-snn",
    encoding=10,
    hidden=12,
    outputs="angular-acceleration",
    output_scale=20.0,
    set_point=SetPointScaling(bound=30.0),
)


def random_snn(config, seed=0):
    """Tensors of any spiking network; of odd seeds with exponents other than 0."""
    rng = np.random.default_rng(seed)
    tensors = {
        name: (2 * rng.integers(-60, 61, shape)).astype(np.int16)
        if name.startswith("w_")
        else rng.integers(1, 2000, shape).astype(np.int16)
        for name, shape in tensor_shapes(config).items()
    }
    return tensors | {
        exponent: rng.integers(-6 * (seed % 2), 1, config.hidden).astype(np.int16)
        for name, exponent in EXPONENTS.items()
        if name in tensors
    }


def readings(n, steps, seed=1):
    """Set-points (n, T, 4), body rates and specific forces (n, T, 3)."""
    rng = np.random.default_rng(seed)
    wanted = rng.normal(size=(n, steps, 4)) * [0.3, 0.3, 1.0, 2.0] + [0, 0, 0, GRAVITY]
    gyro, accel = rng.normal(size=(2, n, steps, 3))
    return wanted, gyro, accel + np.array([0, 0, GRAVITY])


def samples(n, steps, seed=0, rate=1.0, force=0.5):
    """Readings (n, T, 3) twice, white about rest with these deviations [rad/s, m/s²]."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, rate, (n, steps, 3)), rng.normal([0, 0, 9.8], force, (n, steps, 3))
