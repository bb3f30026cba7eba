"""Reduction of the number of decay profiles, so that a network fits on fewer cores."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from .weights_file import Tensors

Array = NDArray[np.float64]


def share_profiles(tensors: Tensors, profiles: int = 32, seed: int = 0) -> Tensors:
    """Limit the number of distinct (du, dv) of a quantised Att-SNN on the chip.

    Time constants are grouped by their logarithms (k-means, 20 starts). The currents of the encoding layer
    are computed on the host, so this layer needs profiles only for its membranes; the outputs need one
    profile. The remaining profiles are divided between the two layers so that the logarithms change least.

    Args:
        tensors: Weights with `syn`, `mem` as the chip's decays.
        profiles: Number of profiles of the whole network, at least 3.
        seed: Seed of the k-means starts.

    Raises:
        ValueError: There are fewer than 3 profiles.
    """
    if profiles < 3:
        raise ValueError(f"profiles: {profiles}, should be at least 3, one for each layer")
    left = profiles - 1
    encoding = np.log(tensors["mem0"].astype(np.float64))[:, None]
    hidden = np.log(np.stack([tensors["syn1"], tensors["mem1"]], 1).astype(np.float64))
    trained = (encoding, hidden)
    best, least = trained, np.inf
    for first in range(1, left):
        groups = zip(trained, (first, left - first), strict=True)
        moved = [_grouped(x, k, seed) for x, k in groups]
        cost = sum(float(np.sum((a - b) ** 2)) for a, b in zip(moved, trained, strict=True))
        if cost < least:
            best, least = (moved[0], moved[1]), cost
    decays = {"mem0": best[0][:, 0], "syn1": best[1][:, 0], "mem1": best[1][:, 1]}
    return tensors | {name: np.rint(np.exp(x)).astype(np.int16) for name, x in decays.items()}


def _grouped(points: Array, groups: int, seed: int) -> Array:
    """Replace each point (n, d) by the centre of its group."""
    distinct = np.unique(points, axis=0)
    if len(distinct) <= groups:
        return points
    best, least = points, np.inf
    for start in range(20):
        rng = np.random.default_rng([seed, start])
        centres, group = kmeans2(points, groups, minit="++", rng=rng, missing="warn")
        cost = float(np.sum((points - centres[group]) ** 2))
        if cost < least:
            best, least = centres[group], cost
    return best
