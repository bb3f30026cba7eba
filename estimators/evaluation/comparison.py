"""Offline comparison of estimators on recorded flights, from an unknown and from a known initial attitude."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator, receives_truth
from quadsim.runs.files import write_csv

from ..circuit.circuit_estimator import Silent
from ..circuit.file import is_circuit
from ..metrics import (
    Summary,
    attitude_error,
    flaw_of,
    inclination_error,
    inclination_rmse,
    share_without_number,
)
from ..networks.gru import Recurrent
from ..networks.network import NetworkEstimator, Spiking, silenced
from ..networks.weights_file import load_network, shipped_names
from ..registry import FILTERPY, NETWORKS, ImuLike, VehicleLike, create, is_weights
from ..running import missing_samples, run_checked, run_quietly
from .flights import Flights, Initial, load_flights, vehicle_of

Array = NDArray[np.float64]
Progress = Callable[[int, int, str], None]
"""Called as progress(finished estimators, all estimators, name of the next one)."""

TILTS_DEG = (20.0, 45.0)
"""Tilts of the vehicle at which estimators are started at level, to measure their recovery [deg]."""
STARTS = 2
"""Largest number of tilted starts per flight."""
SETTLED_DEG = 2.0
"""Inclination error below which an estimator counts as converged [deg]."""
BLOCK_S = 0.5
"""Length of the blocks over which the error is averaged [s]."""

COLUMNS = {
    "log": "Name of a log; empty for a dataset.",
    "estimator": "Name, or path of a network's weights.",
    "initial": 'Whether the initial attitude was given: "known" or "unknown". Networks are never given it.',
    "bias": "For a log: the gyroscope as recorded (raw), or with its mean bias subtracted (known).",
    "median_deg": "Mean absolute error of roll and pitch, pooled, of a sequence; median over sequences.",
    "mean_deg": "Mean over sequences,",
    "sd_deg": "standard deviation,",
    "mean_low_deg": "and ends of the bootstrap 95 % confidence interval of the mean.",
    "mean_high_deg": "",
    "silenced_deg": "Of a network: mean with its output weights at zero; NaN for other estimators.",
    "behind_deg": "Mean over sequences of the error less that of the best estimator with the same start,",
    "behind_low_deg": "and ends of its bootstrap interval: paired, so narrower than the means' own suggest.",
    "behind_high_deg": "",
    "inclination_rmse_deg": "Mean over sequences of the inclination error's RMS; NaN where no sample counts.",
    "silenced_inclination_deg": "The same of a network with its output weights at zero.",
    "settle_20_s": "From an unknown tilt of 20°: time until the median start stays below 2°; NaN: never.",
    "settle_45_s": "The same from 45°.",
    "runtime_ns": "Run time per sample of `run` over all flights.",
    "flights": "Flights it was run on.",
    "scored_s": "Of a log: length of what is scored [s].",
    "missing": "Samples of these that were missing or refused in part or whole, and bridged.",
    "without_number": "Share of estimates that are no finite number or no angle; each counts as 180°.",
    "reference": "Whether it receives the true attitude.",
    "flaw": "What is wrong with its estimates, or why it has none; empty if nothing.",
    "unranked": "Why it is not ranked: a reference, or its flaw; empty if it is.",
    "tied": "Whether it does not differ significantly from the best (the paired interval includes 0).",
    "faults": "Of a log: faults of the sensors that begin inside it; empty if none is found.",
}
"""Columns of the table, which has a row for each log, estimator, start and kind of bias."""


@dataclass
class Evaluation:
    """Results of an evaluation. The keys of dictionaries are (estimator, initial)."""

    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    """The table, with the columns `COLUMNS`."""
    sequences: dict[tuple[str, str], Array] = field(default_factory=dict)
    """Mean absolute error of each sequence of a dataset (n,) [deg]."""
    settling: dict[tuple[str, float], Array] = field(default_factory=dict)
    """For each (estimator, tilt), the inclination error in each block, median over starts [deg]."""

    @property
    def rows(self) -> list[Any]:
        """Rows of the table, with the columns as attributes."""
        return list(self.table.itertuples(index=False))

    @property
    def tilts_deg(self) -> list[float]:
        """Tilts at which estimators were started.

        There are none if no flight reaches such a tilt and lasts long enough.
        """
        return sorted({tilt for (_, tilt), curve in self.settling.items() if curve.size})

    def write_csv(self, path: Path) -> None:
        """Write the table as CSV."""
        write_csv(path, self.table.to_dict("records"))


def behind_the_best(row: Any) -> str:
    """Format the paired difference of a row from the best estimator, with its interval."""
    if row.unranked:
        return "reference" if row.unranked == "reference" else "not ranked"
    if row.behind_low_deg == row.behind_high_deg == 0.0:
        return "the best"
    text = f"{row.behind_deg:.2f}"
    if row.flights > 1:
        text += f" ({row.behind_low_deg:.2f}–{row.behind_high_deg:.2f})"
    return f"tied {text}" if row.tied else text


def evaluate(
    dataset: xr.Dataset,
    estimators: Sequence[str] | Mapping[str, AttitudeEstimator],
    *,
    initial: Sequence[Initial] = ("unknown", "known"),
    settle_s: float = 40.0,
    slow_flights: int | None = None,
    seed: int = 0,
    progress: Progress = lambda *_: None,
) -> Evaluation:
    """Run estimators on the flights of a dataset and compare them with the truth.

    With a known start, an estimator is given the attitude at the first sample and is scored from the second
    sample on. Networks are never given an attitude and have no such row. For networks, the table also has the
    error of the silenced network. Each estimator is compared with the best one, flight by flight. An
    estimator that receives the truth, fails, or gives flawed estimates is listed but not ranked.

    Args:
        dataset: Flights with gyro, accel, quat and the attribute rate_hz.
        estimators: Names of estimators, made for the dataset's vehicle, or a mapping from names to
            estimators.
        initial: Kinds of start to evaluate.
        settle_s: Time for an estimator to recover from a tilted start [s].
        slow_flights: Number of flights for filterpy's slow estimators; None for all.
        seed: Seed of the bootstrap and of the choice of tilted starts.
        progress: Called before every estimator.

    Raises:
        ValueError: The dataset is invalid, an estimator is unknown, or every estimator fails.
    """
    flights = load_flights([dataset])
    steps = min(round(settle_s * flights.rate_hz), flights.gyro.shape[1])
    made = estimators
    if not isinstance(made, Mapping):
        made = made_of(made, flights.rate_hz, vehicle=vehicle_of(dataset))
    result = Evaluation()
    rows: list[dict[str, Any]] = []
    for k, (name, est) in enumerate(made.items()):
        progress(k, len(made), name)
        count = slow_flights if name in FILTERPY else None
        flown = flights.map(lambda each, count=count: each[:count])
        starts = [s for s in initial if s == "unknown" or not isinstance(est, NetworkEstimator)]
        cases = {s: flown.known() if s == "known" else flown for s in starts}
        try:
            for each in cases.values():
                _run(est, each.map(lambda values: values[:, :3], each.start))  # compiles
            curves = {tilt: _settling(est, tilted_starts(flown, tilt, steps, seed)) for tilt in TILTS_DEG}
            found = {s: assessed(name, est, each, seed=seed)[1] for s, each in cases.items()}
        except ValueError as error:
            rows += [failed(name, est, error) | {"initial": s} for s in starts]
            continue
        settled = {f"settle_{tilt:g}_s": _time_below(curve) for tilt, curve in curves.items()}
        rows += [row | settled | {"initial": s} for s, row in found.items()]
        result.settling |= {(name, tilt): curve for tilt, curve in curves.items()}
        result.sequences |= {(name, s): row["sequences"] for s, row in found.items()}
    if rows and not result.sequences:
        flaws = dict.fromkeys(f"{each['estimator']} {each['flaw']}" for each in rows)
        raise ValueError(f"no estimator ran: {'; '.join(flaws)}")
    for each in rows:
        each["unranked"] = "reference" if each["reference"] and each["flights"] else each["flaw"]
    ranked = {(r["estimator"], r["initial"]) for r in rows if not r["unranked"]}
    for each in rows:
        behind = _behind(result.sequences, each["estimator"], each["initial"], ranked, seed)
        each |= dict(zip(("behind_deg", "behind_low_deg", "behind_high_deg"), behind, strict=True))
        each["tied"] = not each["unranked"] and behind[1] <= 0.0
    result.table = pd.DataFrame(rows, columns=list(COLUMNS))
    return result


def assessed(
    name: str, est: AttitudeEstimator, flights: Flights, *, silence: bool = True, seed: int = 0
) -> tuple[Array, dict[str, Any]]:
    """Return estimates (n, T, 2) [rad] of an estimator, its row of the table, and errors by sequence.

    Args:
        name: Name of the estimator.
        est: The estimator.
        flights: The flights.
        silence: Whether to run the silenced network as well.
        seed: Seed of the bootstrap.

    Raises:
        ValueError: The estimator fails, or its `sequence` and its `update` give different estimates.
    """
    truth = flights.truth
    estimate, taken = run_checked(est, flights.readings, flights.start, flights.quat)
    runtime = taken / truth[..., 0].size * 1e9
    row = {"estimator": name, "reference": receives_truth(est), "flights": len(truth), "runtime_ns": runtime}
    row |= {"missing": missing_samples(est)} | errors_of(estimate, truth, seed)
    if silence and (twin := silenced_twin(name, flights.rate_hz)) is not None:
        silent = errors_of(_run(twin, flights), truth)
        row |= {"silenced_deg": silent["mean_deg"]}
        row |= {"silenced_inclination_deg": silent["inclination_rmse_deg"]}
    return estimate, row


def errors_of(estimate: Array, truth: Array, seed: int = 0) -> dict[str, Any]:
    """Return errors and flaws of roll and pitch (n, T, 2) [rad] over samples with known truth, by column."""
    error = attitude_error(estimate, truth)
    low, high = error.mean_interval(seed=seed)
    return {
        "sequences": error.sequences,
        "median_deg": error.median,
        "mean_deg": error.mean,
        "sd_deg": error.sd,
        "mean_low_deg": low,
        "mean_high_deg": high,
        "inclination_rmse_deg": inclination_rmse(estimate, truth).mean,
        "without_number": share_without_number(estimate, truth),
        "flaw": flaw_of(estimate, truth),
    }


def failed(name: str, est: AttitudeEstimator, error: ValueError) -> dict[str, Any]:
    """Return the row of an estimator that failed."""
    flaw = {"flaw": f"did not run: {error}", "flights": 0, "missing": 0, "without_number": 0.0}
    return {"estimator": name, "reference": receives_truth(est)} | flaw


def tilted_starts(flights: Flights, tilt_deg: float, steps: int, seed: int = 0) -> Flights | None:
    """Cut pieces of flights that begin at a given tilt, at most `STARTS` per flight.

    Args:
        flights: The flights.
        tilt_deg: The tilt at the beginning of a piece, to within 1° [deg].
        steps: Length of a piece.
        seed: Seed of the choice of pieces.

    Returns:
        The pieces with an unknown start, or None if no flight has this tilt.
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
    return flights.map(lambda each: np.stack([each[place] for place in places]))


def made_of(
    names: Sequence[str],
    rate_hz: float,
    tuning: str | Path | None = None,
    vehicle: VehicleLike = None,
    imu: ImuLike = None,
) -> dict[str, AttitudeEstimator]:
    """Make estimators by name or path of weights; the arguments are those of `create`."""
    return {name: create(name, rate_hz, tuning=tuning, vehicle=vehicle, imu=imu) for name in names}


def silenced_twin(name: str, rate_hz: float = 200.0) -> NetworkEstimator | None:
    """Make the silenced network of a name or a path of weights; None for other estimators."""
    if name not in (*NETWORKS, *shipped_names()) and not is_weights(name):
        return None
    if is_circuit(name):
        return NetworkEstimator(Silent(), rate_hz)
    config, tensors = load_network(name)
    core = {"att-rnn": Recurrent, "att-snn": Spiking}[config.model]
    return NetworkEstimator(core(config, silenced(config, tensors)), rate_hz)


def _run(est: AttitudeEstimator, flights: Flights) -> Array:
    return run_quietly(est, flights.readings, flights.start, flights.quat)


def _settling(est: AttitudeEstimator, pieces: Flights | None) -> Array:
    """Return the inclination error averaged over each block, median over pieces, (blocks,) [deg]."""
    if pieces is None:
        return np.empty(0)
    error = inclination_error(_run(est, pieces), pieces.truth)
    blocks = error.shape[1] // max(1, round(BLOCK_S * pieces.rate_hz))
    means = [np.nanmean(part, axis=1) for part in np.array_split(error, blocks, axis=1)]
    return np.asarray(np.nanmedian(means, axis=1), np.float64)


def _time_below(curve: Array) -> float:
    """Return the time after which a curve of blocks stays below `SETTLED_DEG` [s]; NaN if it never does."""
    above = np.flatnonzero(~(curve < SETTLED_DEG))
    below = above[-1] + 1 if above.size > 0 else 0
    return float(below * BLOCK_S) if below < curve.size else float("nan")


def _behind(
    sequences: Mapping[tuple[str, str], Array],
    name: str,
    start: str,
    ranked: set[tuple[str, str]],
    seed: int,
) -> tuple[float, float, float]:
    """Return the difference from the best estimator with the same start, with its interval."""
    own = sequences.get((name, start))
    rivals = [error for key, error in sequences.items() if key in ranked and key[1] == start]
    if own is None or not rivals:
        return np.nan, np.nan, np.nan
    most = max(error.size for error in rivals)
    best = min((error for error in rivals if error.size == most), key=lambda error: error.mean())
    common = min(own.size, best.size)
    behind = Summary(own[:common] - best[:common])
    return behind.mean, *behind.mean_interval(seed=seed)
