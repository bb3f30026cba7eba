"""Stages that tune filters by the paper's particle swarm within its bounds."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimators.evaluation.flights import load_flights
from estimators.registry import filter_values, parameter_sets, parameters
from estimators.tuned import Tuned
from estimators.tuning.search import SearchSettings, mean_squared_error, swarm, upright, write_tuning
from quadsim.dataset.reading import open_dataset

from ..stages import FLIGHTS, TUNING, Numbers

GIVEN = {"complementary-adaptive": {"k_a": 0.01}}
"""Parameters that the paper sets."""
LEAST = 1e-6
"""Lower bound of the search for every other parameter, instead of 0; the upper bound is 1."""


def tune_filter(
    folder: Path, *, name: str, flights: Sequence[Path], particles: int, iterations: int, seed: int
) -> Numbers:
    """Tune a filter on flights of both domains from an unknown start."""
    data = upright(load_flights([open_dataset(path / FLIGHTS) for path in flights]))
    given = GIVEN.get(name, {})
    searched = [key for key, each in parameters(name).items() if each.searched and key not in given]

    def values(positions: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        found = dict(zip(searched, np.maximum(positions, LEAST).T, strict=True))
        return found | {key: np.full(len(positions), value) for key, value in given.items()}

    best = swarm(
        lambda positions: mean_squared_error(name, values(positions), data),
        [np.clip(parameters(name)[key].default, 0.0, 1.0) for key in searched],
        SearchSettings(particles=particles, iterations=iterations, seed=seed),
    )
    (found,) = parameter_sets(values(best.position[None]))
    tuned = Tuned(
        command="quadsim paper",
        rate_hz=data.rate_hz,
        rmse_deg=round(float(np.degrees(np.sqrt(best.cost))), 6),
        evaluations=best.evaluations,
        values=filter_values(name, data.rate_hz, found),
    )
    write_tuning(folder / TUNING, name, tuned, "Tuned by the paper's swarm on the flights of both domains.")
    return {"values": {key: tuned.values[key] for key in (*searched, *given)}, "rmse_deg": tuned.rmse_deg}
