"""Random streams that depend only on the seed: one per flight, vehicle and component.

The children equal those of `SeedSequence.spawn` for a new parent, but the parent is not changed. Repeated
calls give the same stream, independent of the number of vehicles and workers and of the active components.
"""

from collections.abc import Sequence
from numbers import Integral
from typing import TypeAlias

import numpy as np

Seed: TypeAlias = int | np.random.SeedSequence | Sequence[np.random.SeedSequence]
"""A whole number, a seed sequence for a batch, or one seed sequence per vehicle."""

TRAJECTORY, BODY, AIR, SENSOR, ANGLES, GROUND, PILOT, BEGINNING, FAULT, EXTERNAL = range(10)
"""Indices of the children of a flight's seed, one per component, the same in every kind of flight."""


def child(parent: np.random.SeedSequence, *key: int) -> np.random.SeedSequence:
    """Return a descendant of a seed sequence: `child(s, 2, 0)` is the first child of the third child of s."""
    return np.random.SeedSequence(
        parent.entropy, spawn_key=(*parent.spawn_key, *key), pool_size=parent.pool_size
    )


def children(parents: Sequence[np.random.SeedSequence], key: int) -> list[np.random.SeedSequence]:
    """Return the child with a given index of each seed sequence."""
    return [child(parent, key) for parent in parents]


def vehicle_seeds(seed: Seed, n: int) -> list[np.random.SeedSequence]:
    """Return one seed sequence per vehicle; the one of vehicle i does not depend on n.

    Raises:
        ValueError: The seed is negative or has the wrong type, or the number of seed sequences is not n.
    """
    if isinstance(seed, Integral):
        if seed < 0:
            raise ValueError(f"seed is {seed}; it must be a whole number from 0 up")
        seed = np.random.SeedSequence(int(seed))
    if isinstance(seed, np.random.SeedSequence):
        return [child(seed, vehicle) for vehicle in range(n)]
    if not isinstance(seed, Sequence) or not all(isinstance(each, np.random.SeedSequence) for each in seed):
        raise ValueError(
            f"seed is {seed!r}; it must be a whole number, a SeedSequence or one for each vehicle"
        )
    if len(seed) != n:
        raise ValueError(f"{len(seed)} seeds for {n} vehicles; there must be one for each")
    return list(seed)
