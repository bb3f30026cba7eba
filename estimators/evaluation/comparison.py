"""Offline comparison of estimators on recorded flights, from an unknown and from a known initial attitude."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator, receives_truth
from quadsim.imu.spec import ImuSpec
from quadsim.runs.files import write_csv
from quadsim.vehicle import Vehicle

from ..metrics import (
    Summary,
    absolute_error,
    attitude_error,
    flaw_of,
    inclination_error,
    inclination_rmse,
    share_without_number,
)
from ..networks.network import NetworkEstimator, OnLoihi, Recurrent, Spiking, silenced
from ..networks.weights_file import load_network, shipped_names
from ..registry import FILTERPY, NETWORKS, create, is_weights
from ..running import missing_samples, require_same, run_quietly, streamed_once
from .flights import Flights, Initial, load_flights, vehicle_of

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
class EvaluationRow:
    """One line of the table. Errors are of roll and pitch pooled, one mean absolute error a sequence."""

    estimator: str
    initial: str
    """Whether the initial attitude was given: "known" or "unknown". Networks are never given it."""
    median_deg: float
    """Over sequences, like mean and SD."""
    mean_deg: float
    sd_deg: float
    mean_low_deg: float
    """Ends of the bootstrap 95 % confidence interval of the mean."""
    mean_high_deg: float
    silenced_deg: float
    """Of a network: mean with its output weights at zero; NaN for other estimators."""
    behind_deg: float
    """Mean over sequences of the error less that of the best estimator with the same start."""
    behind_low_deg: float
    """Ends of the bootstrap interval of that: paired, so it is narrower than the means' own suggest."""
    behind_high_deg: float
    inclination_rmse_deg: float
    """Mean over sequences of the inclination error's RMS."""
    settle_20_s: float
    """Started in an unknown tilt of 20°: time after which the median start stays below 2°; NaN: never."""
    settle_45_s: float
    """The same from 45°."""
    runtime_ns: float
    """Run time per sample of `run` over all flights."""
    flights: int
    """Flights it was run on."""
    missing: int
    """Samples of these that were missing or refused in part or whole, and bridged."""
    without_number: float
    """Share of estimates that are no finite number or no angle, each counted as an error of 180°."""
    reference: bool = False
    """Whether it receives the true attitude."""
    flaw: str = ""
    """What is wrong with its estimates, or why it has none; empty if nothing."""

    @property
    def unranked(self) -> str:
        """Why it is not ranked; empty if it is."""
        return "reference" if self.reference and np.isfinite(self.mean_deg) else self.flaw

    @property
    def tied(self) -> bool:
        """Whether it is not significantly different from the best (the paired interval includes 0)."""
        return not self.unranked and self.behind_low_deg <= 0.0

    @property
    def behind(self) -> str:
        """The paired difference from the best estimator with its interval, as tables show it."""
        if self.unranked:
            return "reference" if self.unranked == "reference" else "not ranked"
        if self.behind_low_deg == self.behind_high_deg == 0.0:
            return "the best"
        text = f"{self.behind_deg:.2f} ({self.behind_low_deg:.2f}–{self.behind_high_deg:.2f})"
        return f"tied {text}" if self.tied else text

    @property
    def silenced(self) -> str:
        """The error of the silenced network, as tables show it; a dash for other estimators."""
        return "–" if np.isnan(self.silenced_deg) else f"{self.silenced_deg:.2f}"


@dataclass
class Evaluation:
    """The table, and what its figures are drawn from; keys are (estimator, initial)."""

    rows: list[EvaluationRow] = field(default_factory=list)
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
        """Write the table, one line a row, the header being the fields of `EvaluationRow`."""
        write_csv(path, self.rows)


def evaluate(
    dataset: xr.Dataset,
    estimators: Sequence[str] | Mapping[str, AttitudeEstimator],
    *,
    initial: Sequence[Initial] = ("unknown", "known"),
    settle_s: float = 40.0,
    slow_flights: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
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
        progress: Called before every run.

    Raises:
        ValueError: For a dataset that is not one, an unknown estimator, or where every estimator fails.
    """
    progress = progress or (lambda *_: None)
    flights = load_flights([dataset])
    rate_hz = flights.rate_hz
    made = (
        estimators
        if isinstance(estimators, Mapping)
        else made_of(estimators, rate_hz, vehicle=vehicle_of(dataset))
    )
    result = Evaluation(time_s=_block_times(flights.gyro.shape[1], rate_hz), rate_hz=rate_hz)
    steps = min(round(settle_s * rate_hz), flights.gyro.shape[1])
    measured: list[dict[str, Any]] = []
    starts = {name: _starts_of(est, initial) for name, est in made.items()}
    runs, done = sum(len(TILTS_DEG) + len(each) for each in starts.values()), 0
    for name, est in made.items():
        flown = flights.first(slow_flights) if slow_flights and name in FILTERPY else flights
        steps_done = iter(range(done, runs))
        done += len(TILTS_DEG) + len(starts[name])

        def advance(name: str = name, steps_done: Iterator[int] = steps_done) -> None:
            progress(next(steps_done), runs, name)

        try:
            measured += _measured(name, est, flown, starts[name], steps, seed, result, advance)
        except ValueError as error:
            measured += [_failed(name, start, receives_truth(est), error) for start in starts[name]]
    progress(runs, runs, "")
    if measured and not result.sequences:
        flaws = dict.fromkeys(f"{each['estimator']} {each['flaw']}" for each in measured)
        raise ValueError(f"no estimator ran: {'; '.join(flaws)}")
    ranked = {
        (each["estimator"], each["initial"]): result.sequences[each["estimator"], each["initial"]]
        for each in measured
        if not (each["reference"] or each["flaw"])
    }
    for each in measured:
        own = result.sequences.get((each["estimator"], each["initial"]))
        behind, low, high = _behind(own, ranked, each["initial"], seed)
        row = EvaluationRow(**each, behind_deg=behind, behind_low_deg=low, behind_high_deg=high)
        result.rows.append(row)
    return result


def _measured(
    name: str,
    est: AttitudeEstimator,
    flown: Flights,
    starts: Sequence[Initial],
    steps: int,
    seed: int,
    result: Evaluation,
    advance: Callable[[], None],
) -> list[dict[str, Any]]:
    """Fields of one estimator's rows; what figures are drawn from goes to the result."""
    short = flown.map(lambda each: each[:, :3])
    for start in starts:
        _run(est, short.known() if start == "known" else short)  # compiles
    curves = []
    for tilt in TILTS_DEG:
        advance()
        curves.append(_settling(est, tilted_starts(flown, tilt, steps, seed)))
    without = silenced_twin(name, result.rate_hz)
    rows, errors, over_time = [], {}, {}
    for start in starts:
        advance()
        chosen = flown.known() if start == "known" else flown
        streamed = streamed_once(est, chosen.gyro, chosen.accel, chosen.start, **chosen.readings.others)
        begin = time.perf_counter()
        estimate = _run(est, chosen)
        runtime = (time.perf_counter() - begin) / chosen.truth[..., 0].size * 1e9
        require_same(est, estimate, streamed)
        error = attitude_error(estimate, chosen.truth)
        low, high = error.mean_interval(seed=seed)
        silent = np.nan if without is None else attitude_error(_run(without, chosen), chosen.truth).mean
        errors[name, start] = error.sequences
        over_time[name, start] = _blocks(estimate, chosen.truth, result.time_s.size)
        rows.append(
            {
                "estimator": name,
                "initial": start,
                "median_deg": error.median,
                "mean_deg": error.mean,
                "sd_deg": error.sd,
                "mean_low_deg": low,
                "mean_high_deg": high,
                "silenced_deg": silent,
                "inclination_rmse_deg": inclination_rmse(estimate, chosen.truth).mean,
                "settle_20_s": _time_below(curves[0]),
                "settle_45_s": _time_below(curves[1]),
                "runtime_ns": runtime,
                "flights": len(chosen.gyro),
                "missing": missing_samples(est),
                "without_number": share_without_number(estimate, chosen.truth),
                "reference": receives_truth(est),
                "flaw": flaw_of(estimate, chosen.truth),
            }
        )
    result.settling |= {(name, tilt): curve for tilt, curve in zip(TILTS_DEG, curves, strict=True)}
    result.sequences |= errors
    result.over_time |= over_time
    return rows


def _failed(name: str, start: str, reference: bool, error: ValueError) -> dict[str, Any]:
    """Fields of the row of an estimator that did not run."""
    known: dict[str, Any] = {"estimator": name, "initial": start, "reference": reference}
    known |= {"flights": 0, "missing": 0, "flaw": f"did not run: {error}"}
    behind = {"behind_deg", "behind_low_deg", "behind_high_deg"}
    return known | {f.name: np.nan for f in fields(EvaluationRow) if f.name not in known.keys() | behind}


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
    vehicle: str | Path | Vehicle | None = None,
    imu: str | Path | ImuSpec | None = None,
) -> dict[str, AttitudeEstimator]:
    """Estimators by name, or by the path of a network's weights; the arguments are those of `create`."""
    return {name: create(name, rate_hz, tuning=tuning, vehicle=vehicle, imu=imu) for name in names}


def silenced_twin(name: str, rate_hz: float = 200.0) -> NetworkEstimator | None:
    """The network of a name or of a path of weights, with output weights of zero; None for others."""
    if name not in (*NETWORKS, *shipped_names()) and not is_weights(name):
        return None
    config, tensors = load_network(name.removesuffix("-loihi"))
    core = {"att-rnn": Recurrent, "att-snn": OnLoihi if name.endswith("-loihi") else Spiking}[config.model]
    return NetworkEstimator(core(config, silenced(config, tensors)), rate_hz)


def _starts_of(est: AttitudeEstimator, initial: Sequence[Initial]) -> list[Initial]:
    return [start for start in initial if start == "unknown" or not isinstance(est, NetworkEstimator)]


def _run(est: AttitudeEstimator, flights: Flights) -> Array:
    others = flights.readings.others
    return run_quietly(est, flights.gyro, flights.accel, flights.start, flights.quat, **others)


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


def _block_times(steps: int, rate_hz: float) -> Array:
    size = max(1, round(BLOCK_S * rate_hz))
    return (np.arange(steps // size, dtype=np.float64) + 0.5) * size / rate_hz


def _blocks(estimate: Array, truth: Array, blocks: int) -> Array:
    """Mean absolute error in each block (n, blocks); the last takes what is missing at a known start."""
    error = absolute_error(estimate, truth).mean(axis=-1)
    parts = np.array_split(error, blocks, axis=1)
    return np.stack([np.asarray(np.nanmean(part, axis=1), np.float64) for part in parts], axis=1)


def _behind(
    own: Array | None, ranked: Mapping[tuple[str, str], Array], start: str, seed: int
) -> tuple[float, float, float]:
    """Difference from the best estimator of the same start on the flights of both, with its interval."""
    rivals = [error for (_, at), error in ranked.items() if at == start]
    if own is None or not rivals:
        return np.nan, np.nan, np.nan
    most = max(error.size for error in rivals)
    best = min((error for error in rivals if error.size == most), key=lambda error: error.mean())
    common = min(own.size, best.size)
    behind = Summary(own[:common] - best[:common])
    return behind.mean, *behind.mean_interval(seed=seed)
