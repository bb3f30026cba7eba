"""Ablation: networks without some of their neurons, and their errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..evaluation.flights import Flights
from ..metrics import attitude_error
from ..networks.layer_parameters import PARAMETERS
from ..networks.network import NetworkEstimator, Spiking
from ..networks.weights_file import NetworkConfig, Tensors

Array = NDArray[np.float64]


def without(
    config: NetworkConfig, tensors: Tensors, keep: Sequence[NDArray[np.int64]]
) -> tuple[NetworkConfig, Tensors]:
    """Return the network of the connected neurons, given by their indices in encoding and hidden layer."""
    left = {name: np.sort(ids) for name, ids in zip(("encoding", "hidden"), keep, strict=True)}
    smaller = dict(tensors)
    for name in tensors:
        for k, axis in enumerate(PARAMETERS[name].axes):
            if axis in left:
                smaller[name] = smaller[name].take(left[axis], k)
    return config.model_copy(update={name: ids.size for name, ids in left.items()}), smaller


def pruned(
    config: NetworkConfig, tensors: Tensors, values: Sequence[Array], fraction: float
) -> tuple[NetworkConfig, Tensors]:
    """Remove the fraction of all neurons with the smallest values; at least one neuron of each layer remains.

    Raises:
        ValueError: The fraction is outside [0, 1).
    """
    if not 0.0 <= fraction < 1.0:
        raise ValueError(f"fraction: {fraction}, should be in [0, 1)")
    encoding, whole = values[0].size, np.concatenate(list(values))
    whole[[int(np.argmax(values[0])), encoding + int(np.argmax(values[1]))]] = np.inf
    chosen = np.argsort(-whole, kind="stable")[: max(2, round(whole.size * (1 - fraction)))]
    return without(config, tensors, [chosen[chosen < encoding], chosen[chosen >= encoding] - encoding])


def error_deg(config: NetworkConfig, tensors: Tensors, flights: Flights) -> float:
    """Return the mean absolute error of roll and pitch from an unknown start [deg]."""
    est = NetworkEstimator(Spiking(config, tensors), config.rate_hz)
    est.reset(len(flights.gyro))
    return attitude_error(est.sequence(flights.gyro, flights.accel), flights.truth).mean
