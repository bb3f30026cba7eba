"""Offline comparison of estimators on recorded flights, with and without knowing how they start."""

import csv
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator

from .flights import Flights, Initial, load_flights
from .metrics import Summary, absolute_error, attitude_error, inclination_error, inclination_rmse
from .protocol import create, run

Array = NDArray[np.float64]
Progress = Callable[[int, int, str], None]
"""progress(runs done, runs in all, estimator that is next)."""

TILTS_DEG = (20.0, 45.0)
"""Tilts in which estimators that take themselves to be level are started, to time their recovery."""
STARTS = 2
"""How many such starts are taken of each flight."""
SETTLED_DEG = 2.0
"""Inclination error below which an estimator counts as converged."""
BLOCK_S = 0.5
"""Error over time is averaged over blocks of this length."""


@dataclass(frozen=True)
class Row:
    """One line of the table. Errors are of roll and pitch pooled, one mean absolute error a sequence."""

    estimator: str
    initial: str
    """Whether the estimator was told the attitude at the start."""
    median_deg: float
    """Over sequences, like mean and SD."""
    mean_deg: float
    sd_deg: float
    mean_low_deg: float
    """Ends of the bootstrap 95 % confidence interval of the mean."""
    mean_high_deg: float
    inclination_rmse_deg: float
    """Mean over sequences of the inclination error's RMS."""
    settle_20_s: float
    """Started in an unknown tilt of 20°: time after which the median start stays below 2°; NaN: never."""
    settle_45_s: float
    """The same from 45°."""
    runtime_ns: float
    """Run time per sample of `run` over all flights."""


@dataclass
class Evaluation:
    """The table, and what its figures are drawn from; keys are (estimator, initial)."""

    rows: list[Row] = field(default_factory=list)
    sequences: dict[tuple[str, str], Array] = field(default_factory=dict)
    """Mean absolute error of each sequence (n,) [deg]."""
    time_s: Array = field(default_factory=lambda: np.empty(0))
    """Centres of the blocks of `over_time`."""
    over_time: dict[tuple[str, str], Array] = field(default_factory=dict)
    """Mean absolute error in each block of each sequence (n, blocks) [deg]."""
    settling: dict[tuple[str, float], Array] = field(default_factory=dict)
    """(estimator, tilt) to the median over starts of the inclination error in each block [deg]."""
    rate_hz: float = 0.0

    def write_csv(self, path: Path) -> None:
        """Write the table, one line a row, the header being the fields of `Row`."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, [each.name for each in fields(Row)])
            writer.writeheader()
            writer.writerows(asdict(row) for row in self.rows)


def evaluate(
    dataset: xr.Dataset,
    estimators: Sequence[str] | Mapping[str, AttitudeEstimator],
    *,
    initial: Sequence[Initial] = ("unknown", "known"),
    tuning: str | Path | None = None,
    settle_s: float = 40.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> Evaluation:
    """Run estimators over the flights of a dataset and compare them with the truth.

    With a known start the estimator is told the attitude at the first sample and scored from the second on.
    A network has no attitude to start from: its two rows differ by that one sample.

    Args:
        dataset: Flights with gyro, accel, quat and the attribute rate_hz.
        estimators: Names, or estimators under the names they are to have.
        initial: Which rows to make.
        tuning: Parameters of the estimators given by name, as in `create`.
        settle_s: Time that an estimator started in a tilt is given to recover [s].
        seed: Of the bootstrap and of the choice of those starts.
        progress: Called before every run.

    Raises:
        ValueError: For a dataset that is not one, or an unknown estimator.
    """
    flights = load_flights([dataset])
    rate_hz = flights.rate_hz
    made = estimators if isinstance(estimators, Mapping) else _made(estimators, rate_hz, tuning)
    result = Evaluation(time_s=_block_times(flights.gyro.shape[1], rate_hz), rate_hz=rate_hz)
    steps = min(round(settle_s * rate_hz), flights.gyro.shape[1])
    pieces = {tilt: tilted_starts(flights, tilt, steps, seed) for tilt in TILTS_DEG}
    for index, (name, est) in enumerate(made.items()):
        if progress is not None:
            progress(index, len(made), name)
        run(est, flights.gyro[:, :2], flights.accel[:, :2], quat=flights.quat[:, :2])  # compiles
        settle = {tilt: _settling(est, pieces[tilt]) for tilt in TILTS_DEG}
        result.settling |= {(name, tilt): curve for tilt, curve in settle.items()}
        times = [_time_below(curve) for curve in settle.values()]
        for start in initial:
            chosen = flights.known() if start == "known" else flights
            begin = time.perf_counter()
            estimate = _run(est, chosen)
            runtime = (time.perf_counter() - begin) / chosen.truth[..., 0].size * 1e9
            error = attitude_error(estimate, chosen.truth)
            rmse = inclination_rmse(estimate, chosen.truth).mean
            result.rows.append(_row(name, start, error, rmse, times, runtime, seed))
            result.sequences[name, start] = error.sequences
            result.over_time[name, start] = _blocks(estimate, chosen.truth, result.time_s.size)
    return result


def tilted_starts(flights: Flights, tilt_deg: float, steps: int, seed: int = 0) -> Flights | None:
    """Pieces of flights that begin where the vehicle is tilted by an angle, `STARTS` of each flight at most.

    Args:
        flights: Where to look.
        tilt_deg: The tilt, met to 1°.
        steps: Length of a piece.
        seed: Of the choice among the places.

    Returns:
        The pieces with an unknown start, or None if there is no such place.
    """
    rng = np.random.default_rng(seed)
    tilt = inclination_error(flights.truth, np.zeros_like(flights.truth))
    places = []
    for flight, each in enumerate(np.abs(tilt[:, : tilt.shape[1] - steps + 1] - tilt_deg) < 1.0):
        found = np.flatnonzero(each)
        chosen = rng.choice(found, min(STARTS, found.size), replace=False)
        places += [(flight, slice(first, first + steps)) for first in np.sort(chosen)]
    if not places:
        return None
    gyro, accel, quat, truth = (
        np.stack([array[place] for place in places])
        for array in (flights.gyro, flights.accel, flights.quat, flights.truth)
    )
    return Flights(gyro, accel, quat, truth, flights.rate_hz)


def _made(
    estimators: Sequence[str], rate_hz: float, tuning: str | Path | None
) -> dict[str, AttitudeEstimator]:
    return {name: create(name, rate_hz, tuning=tuning) for name in estimators}


def _run(est: AttitudeEstimator, flights: Flights) -> Array:
    return run(est, flights.gyro, flights.accel, roll_pitch=flights.start, quat=flights.quat)


def _settling(est: AttitudeEstimator, pieces: Flights | None) -> Array:
    """Median over pieces of the inclination error, averaged over each block, (blocks,) [deg]."""
    if pieces is None:
        return np.empty(0)
    error = inclination_error(_run(est, pieces), pieces.truth)
    blocks = _block_times(error.shape[1], pieces.rate_hz).size
    means = [np.nanmean(part, axis=1) for part in np.array_split(error, blocks, axis=1)]
    return np.asarray(np.nanmedian(np.stack(means, axis=1), axis=0), np.float64)


def _time_below(curve: Array) -> float:
    """Time after which a curve of blocks stays below `SETTLED_DEG` [s]; NaN if it never does."""
    above = np.flatnonzero(~(curve < SETTLED_DEG))
    if curve.size == 0 or (above.size > 0 and above[-1] == curve.size - 1):
        return float("nan")
    return 0.0 if above.size == 0 else (float(above[-1]) + 1.0) * BLOCK_S


def _block(rate_hz: float) -> int:
    return max(1, round(BLOCK_S * rate_hz))


def _block_times(steps: int, rate_hz: float) -> Array:
    size = _block(rate_hz)
    return (np.arange(steps // size, dtype=np.float64) + 0.5) * size / rate_hz


def _blocks(estimate: Array, truth: Array, blocks: int) -> Array:
    """Mean absolute error in each block (n, blocks); the last takes what is missing at a known start."""
    error = absolute_error(estimate, truth).mean(axis=-1)
    parts = np.array_split(error, blocks, axis=1)
    return np.stack([np.asarray(np.nanmean(part, axis=1), np.float64) for part in parts], axis=1)


def _row(
    name: str, start: str, error: Summary, rmse: float, times: list[float], runtime: float, seed: int
) -> Row:
    low, high = error.mean_interval(seed=seed)
    return Row(name, start, error.median, error.mean, error.sd, low, high, rmse, times[0], times[1], runtime)
