"""Search for the parameters of a filter with the smallest error on training flights.

The search space is the unit cube; `Parameter.at` maps each coordinate to a parameter, mostly logarithmically
between `low` and `high`. The cost is that of the paper (Stroobants, Dupeyroux, de Croon 2022): the mean
squared error of roll and pitch per sample [rad²], averaged over flights. A position outside the cube is
scored at the nearest point inside, with a penalty of 10.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import OptimizeResult, differential_evolution

from quadsim.config.toml import preset_names
from quadsim.estimator import AttitudeEstimator, Readings, receives_truth
from quadsim.held_out import unreserved
from quadsim.imu.spec import load_imu
from quadsim.runs.files import alone, write_whole

from ..custom import is_custom
from ..evaluation.flights import Flights, imu_of, load_flights, vehicle_of
from ..filters.samples import squared_error
from ..metrics import flaw_of
from ..registry import FILTERPY, airframe_constants, create, filter_values, names, parameter_sets, parameters
from ..running import run_quietly
from ..tuned import Tuned, load_tuning, to_toml

Array = NDArray[np.float64]
Cost = Callable[[Array], Array]
Progress = Callable[[int, int, float], None]
"""Called as progress(finished iterations, all iterations, lowest cost [rad²])."""

PENALTY = 10.0
"""Penalty for a position outside the unit cube."""
PITCH_MOST = np.radians(75.0)
"""Largest true pitch of scored samples [rad]; towards 90°, the error of roll grows without bound."""
FIRST_SPEED = 0.1
"""Bound of the initial velocities of the swarm, which are uniform in ± this value."""


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search."""

    method: Literal["swarm", "evolution"] = "swarm"
    """Particle swarm, or differential evolution."""
    particles: int = 100
    """Number of parameter sets in the swarm."""
    iterations: int = 50
    """Number of evaluations of all particles."""
    seed: int = 0


@dataclass(frozen=True)
class SearchResult:
    """Best position in the unit cube."""

    position: Array
    """Best position (d,)."""
    cost: float
    evaluations: int


def mean_squared_error(name: str, sets: Mapping[str, ArrayLike], flights: Flights, workers: int = 1) -> Array:
    """Return the cost of p parameter sets [rad²], shape (p,); infinite for sets with flawed estimates.

    Args:
        name: Estimator.
        sets: Values (p,) by parameter name; other parameters have their defaults.
        flights: The flights.
        workers: Number of threads for a compiled filter.
    """
    made = [_made(name, flights.rate_hz, each) for each in parameter_sets(sets)]
    with ThreadPoolExecutor(1 if is_custom(name) else workers) as pool:
        return np.array(list(pool.map(lambda est: _error_of(est, is_custom(name), flights), made)))


def _made(name: str, rate_hz: float, values: Mapping[str, float]) -> AttitudeEstimator:
    return create(name, rate_hz, tuning=None, vehicle=None, imu=None, **values)


def _error_of(est: AttitudeEstimator, is_of_user: bool, flights: Flights) -> float:
    """Return the cost of one estimator; compiled filters run without the interpreter's lock."""
    readings = flights.readings if is_of_user else Readings(flights.gyro, flights.accel)
    estimate = run_quietly(est, readings, flights.start)
    if is_of_user and flaw_of(estimate, flights.truth):
        return math.inf
    scored = np.isfinite(flights.truth).all(axis=-1).sum(axis=1) * 2
    return float((squared_error(estimate, flights.truth) / scored).mean())


def swarm(
    cost: Cost, first: ArrayLike, search: SearchSettings, progress: Progress = lambda *_: None
) -> SearchResult:
    """Minimise by a particle swarm in the unit cube (Shi & Eberhart 1998), with the paper's weights.

    v ← w v + c1 r1 (own best − x) + c2 r2 (swarm's best − x),  x ← x + v;  w = 0.8, c1 = 0.15, c2 = 0.05.

    Args:
        cost: Positions inside the cube (p, d) -> costs (p,).
        first: Position of the first particle (d,); the others are random.
        search: Size of the swarm, iterations and seed.
        progress: Called after every iteration.
    """
    particles, iterations = search.particles, search.iterations
    rng = np.random.default_rng(search.seed)
    x = rng.uniform(0.0, 1.0, (particles, np.size(first)))
    x[0] = first
    v = rng.uniform(-FIRST_SPEED, FIRST_SPEED, x.shape)
    own, own_cost = x.copy(), np.full(particles, np.inf)
    for iteration in range(iterations):
        inside = np.clip(x, 0.0, 1.0)
        now = cost(inside) + PENALTY * np.any(x != inside, axis=1)
        better = now < own_cost
        own[better], own_cost[better] = inside[better], now[better]
        best = own[np.argmin(own_cost)]
        progress(iteration + 1, iterations, float(own_cost.min()))
        r1, r2 = rng.uniform(0.0, 1.0, (2, *x.shape))
        v = 0.8 * v + 0.15 * r1 * (own - x) + 0.05 * r2 * (best - x)
        x = x + v
    return SearchResult(own[np.argmin(own_cost)], float(own_cost.min()), particles * iterations)


def evolution(
    cost: Cost, first: ArrayLike, search: SearchSettings, progress: Progress = lambda *_: None
) -> SearchResult:
    """Minimise by SciPy's differential evolution, to check that the swarm is not in a local minimum."""

    def report(intermediate_result: OptimizeResult) -> None:
        progress(intermediate_result.nit, search.iterations, float(intermediate_result.fun))

    result = differential_evolution(
        lambda x: cost(np.clip(x.T, 0.0, 1.0)),
        [(0.0, 1.0)] * np.size(first),
        x0=np.asarray(first),
        popsize=max(1, search.particles // np.size(first)),
        maxiter=search.iterations,
        rng=search.seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        callback=report,
    )
    return SearchResult(np.asarray(result.x), float(result.fun), result.nfev * len(result.population))


SEARCHES = {"swarm": swarm, "evolution": evolution}
DEFAULT_SEARCH = SearchSettings()


def tune(
    name: str,
    datasets: Sequence[xr.Dataset],
    search: SearchSettings = DEFAULT_SEARCH,
    *,
    flights: int | None = None,
    pieces: int = 1,
    workers: int = 1,
    command: str = "estimators.tuning.search.tune",
    progress: Progress = lambda *_: None,
) -> Tuned:
    """Tune one estimator on recorded flights, from an unknown start.

    Args:
        name: Estimator with parameters to search.
        datasets: Training flights; constants of the vehicle and IMU come from the first.
        search: How the parameters are searched.
        flights: Number of flights of each dataset; None for all.
        pieces: Number of parts of each flight. All parts but the first begin in motion.
        workers: Number of threads.
        command: Command to record in the result.
        progress: Called after every iteration.

    Raises:
        ValueError: The estimator has no parameters to search, receives the truth, or gives flawed estimates
            with all parameters; or a dataset is invalid, or has or gets a seed of a held-out suite.
    """
    for seed in (search.seed, *(dataset.attrs.get("seed", 0) for dataset in datasets)):
        unreserved(int(seed))
    searched = [key for key, each in parameters(name).items() if each.searched]
    if not searched:
        raise ValueError(f"{name} has no parameters to tune")
    if is_custom(name) and receives_truth(create(name, float(datasets[0].attrs.get("rate_hz", 200.0)))):
        raise ValueError(f"{name} receives the true attitude: there is nothing to tune")
    data = upright(load_flights(datasets, flights).pieces(pieces))
    airframe = airframe_constants(name, vehicle_of(datasets[0]))
    constants = airframe | imu_constants(name, datasets[0])

    def values(positions: Array) -> dict[str, Array]:
        sets = {key: parameters(name)[key].at(x) for key, x in zip(searched, positions.T, strict=True)}
        return sets | {key: np.full(len(positions), value) for key, value in constants.items()}

    best = SEARCHES[search.method](
        lambda positions: mean_squared_error(name, values(positions), data, workers),
        [parameters(name)[key].position(parameters(name)[key].default) for key in searched],
        search,
        progress,
    )
    (found,) = parameter_sets(values(best.position[None]))
    if not math.isfinite(best.cost):
        est = _made(name, data.rate_hz, found)
        flaw = flaw_of(run_quietly(est, Readings(data.gyro, data.accel), data.start), data.truth)
        raise ValueError(f"no parameters of {name} give estimates that can be scored: it {flaw}")
    return Tuned(
        command=command,
        **flown_on(datasets),
        rate_hz=data.rate_hz,
        rmse_deg=round(float(np.degrees(np.sqrt(best.cost))), 6),
        evaluations=best.evaluations,
        values={
            key: float(f"{value:.6g}")
            for key, value in filter_values(name, data.rate_hz, found).items()
            if key not in airframe
        },
    )


def upright(flights: Flights) -> Flights:
    """Mark the truth as unknown where roll is hardly defined, and drop flights without other samples."""
    steep = np.abs(flights.truth[..., 1:]) > PITCH_MOST
    truth = np.where(steep, np.nan, flights.truth)
    known = np.isfinite(truth).any(axis=(1, 2))
    return replace(flights, truth=truth).map(lambda each: each[known])


def tunable() -> list[str]:
    """Return the estimators that `--estimator all` tunes; `write_tuning` handles filterpy's."""
    return [
        name
        for name in names()
        if name not in FILTERPY and any(each.searched for each in parameters(name).values())
    ]


def flown_on(datasets: Sequence[xr.Dataset]) -> dict[str, str]:
    """Return the fields `vehicle` and `imu` of `Tuned`.

    The fields are empty if datasets differ or the IMU is not a shipped one.
    """
    vehicles = {vehicle.name if (vehicle := vehicle_of(each)) else "" for each in datasets}
    shipped = [
        name for name in preset_names("imus") if all(load_imu(name) == imu_of(each) for each in datasets)
    ]
    return {"vehicle": vehicles.pop() if len(vehicles) == 1 else "", "imu": shipped[0] if shipped else ""}


def imu_constants(name: str, dataset: xr.Dataset) -> dict[str, float]:
    """Return the parameters that follow from the IMU; none if the IMU of the dataset is not known."""
    imu = imu_of(dataset)
    if name != "ekf-drag" or imu is None:
        return {}
    return {"bias_sigma": imu.gyro.turn_on, "accel_bias_sigma": imu.accel.turn_on}


def write_tuning(path: Path, name: str, tuned: Tuned, comment: str) -> None:
    """Write the table of one estimator to a tuning file; other tables in the file are kept.

    The table of ekf is also written for filterpy's filters, which have the same model and are much slower.

    Args:
        path: TOML file, which is created if necessary.
        name: Estimator.
        tuned: The parameters.
        comment: Comment at the top of a new file.
    """
    found = {name: tuned}
    if name == "ekf":
        shared = tuned.model_copy(update={"command": f"the values of ekf: {tuned.command}"})
        found |= dict.fromkeys(FILTERPY, shared)
    with alone(path, wait_s=10.0):  # a process that tunes another filter may write its own
        tables = load_tuning(path) if path.exists() else {}
        if path.exists():
            top = itertools.takewhile(lambda line: line.startswith("#"), path.read_text("utf-8").splitlines())
            comment = "\n".join(line[1:].removeprefix(" ") for line in top) or comment
        write_whole(path, to_toml(tables | found, comment))
