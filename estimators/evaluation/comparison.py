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
"""progress(estimators done, estimators in all, the one that is next)."""

TILTS_DEG = (20.0, 45.0)
"""Tilts in which estimators that take themselves to be level are started, to time their recovery."""
STARTS = 2
"""How many such starts are taken of each flight."""
SETTLED_DEG = 2.0
"""Inclination error below which an estimator counts as converged."""
BLOCK_S = 0.5
"""Error over time is averaged over blocks of this length."""

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
"""Columns of the table, a row for each log, estimator, start and kind of bias."""


@dataclass
class Evaluation:
    """The table, and what its figures are drawn from; keys are (estimator, initial)."""

    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    """The columns are those of `COLUMNS`."""
    sequences: dict[tuple[str, str], Array] = field(default_factory=dict)
    """Mean absolute error of each sequence of a dataset (n,) [deg]."""
    settling: dict[tuple[str, float], Array] = field(default_factory=dict)
    """(estimator, tilt) to the median over starts of the inclination error in each block [deg]."""

    @property
    def rows(self) -> list[Any]:
        """Rows of the table, with its columns as attributes."""
        return list(self.table.itertuples(index=False))

    @property
    def tilts_deg(self) -> list[float]:
        """Tilts that estimators were started in; none if no flight has such a tilt and lasts long enough."""
        return sorted({tilt for (_, tilt), curve in self.settling.items() if curve.size})

    def write_csv(self, path: Path) -> None:
        """Write the table."""
        write_csv(path, self.table.to_dict("records"))


def behind_the_best(row: Any) -> str:
    """The paired difference of a row from the best estimator with its interval, as tables show it."""
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
    """Run estimators over the flights of a dataset and compare them with the truth.

    With a known start the estimator is given the attitude at the first sample and scored from the second on;
    networks are never given it and have no such row. A network, known by its name or the path of its weights,
    has beside its error that of the same network with output weights of zero. An estimator is compared with
    the best one flight by flight. One that receives the truth, fails, or whose estimates have a flaw, is
    listed and is not ranked.

    Args:
        dataset: Flights with gyro, accel, quat and the attribute rate_hz.
        estimators: Names, made for the dataset's vehicle, or estimators under the names they are to have.
        initial: Which rows to make.
        settle_s: Time that an estimator started in a tilt is given to recover [s].
        slow_flights: Flights that filterpy's slow estimators are run on; None for all.
        seed: Of the bootstrap and of the choice of those starts.
        progress: Called before every estimator.

    Raises:
        ValueError: For a dataset that is not one, an unknown estimator, or where every estimator fails.
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
    """Estimates (n, T, 2) [rad] of an estimator, and its row of the table beside the errors of its sequences.

    Args:
        name: Its name, by which networks are known.
        est: The estimator.
        flights: What it is run on.
        silence: Run a network with output weights of zero, too.
        seed: Of the bootstrap.

    Raises:
        ValueError: It does not run, or its `sequence` does not give the estimates of its `update`.
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
    """Errors and flaws of roll and pitch (n, T, 2) [rad] over samples whose truth is known, by column."""
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
    """The row of an estimator that did not run."""
    flaw = {"flaw": f"did not run: {error}", "flights": 0, "missing": 0, "without_number": 0.0}
    return {"estimator": name, "reference": receives_truth(est)} | flaw


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
    return flights.map(lambda each: np.stack([each[place] for place in places]))


def made_of(
    names: Sequence[str],
    rate_hz: float,
    tuning: str | Path | None = None,
    vehicle: VehicleLike = None,
    imu: ImuLike = None,
) -> dict[str, AttitudeEstimator]:
    """Estimators by name, or by the path of a network's weights; the arguments are those of `create`."""
    return {name: create(name, rate_hz, tuning=tuning, vehicle=vehicle, imu=imu) for name in names}


def silenced_twin(name: str, rate_hz: float = 200.0) -> NetworkEstimator | None:
    """The network of a name or of a path of weights, with output weights of zero; None for others."""
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
    """Median over pieces of the inclination error, averaged over each block, (blocks,) [deg]."""
    if pieces is None:
        return np.empty(0)
    error = inclination_error(_run(est, pieces), pieces.truth)
    blocks = error.shape[1] // max(1, round(BLOCK_S * pieces.rate_hz))
    means = [np.nanmean(part, axis=1) for part in np.array_split(error, blocks, axis=1)]
    return np.asarray(np.nanmedian(means, axis=1), np.float64)


def _time_below(curve: Array) -> float:
    """Time after which a curve of blocks stays below `SETTLED_DEG` [s]; NaN if it never does."""
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
    """Difference from the best estimator of the same start on the flights of both, with its interval."""
    own = sequences.get((name, start))
    rivals = [error for key, error in sequences.items() if key in ranked and key[1] == start]
    if own is None or not rivals:
        return np.nan, np.nan, np.nan
    most = max(error.size for error in rivals)
    best = min((error for error in rivals if error.size == most), key=lambda error: error.mean())
    common = min(own.size, best.size)
    behind = Summary(own[:common] - best[:common])
    return behind.mean, *behind.mean_interval(seed=seed)
