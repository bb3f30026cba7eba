"""Estimators on recorded logs: errors as benchmarks of inertial sensors count them, beside a level guess.

Inclination error, as a root mean square over the samples that count: the attitude and the readings are known,
the log marks the sample (`scored`), the first seconds are over, and the vehicle is tilted less than a limit.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator, receives_truth
from quadsim.logs.log_faults import SensorFault
from quadsim.logs.truth import GyroBias, bias_by_truth

from ..metrics import inclination_error
from ..registry import FILTERPY, names, needs_vehicle
from .beliefs import Beliefs, Coverage, beliefs
from .comparison import COLUMNS, Evaluation, Progress, assessed, errors_of, failed, made_of
from .flights import Flights, load_flights
from .without_truth import FEWEST, LEVEL, LOW_PASS_S, Comparison, compare, is_larger, motion

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)

RAW, KNOWN, SILENCED = KINDS = "raw", "known", "silenced"
"""The gyroscope as recorded, with its mean bias over the log subtracted where it is significant, and as
recorded for a network with output weights of zero."""
OF_DATASETS = ("median", "sd", "mean_low", "mean_high", "behind", "settle", "unranked", "tied")
"""How columns begin that compare flights of a dataset, which a log has none of."""
NO_ATTITUDE = "it has no attitude"
"""Why a log is compared in place of scored."""
SKIP_S = 3.0
"""Time at the start that is not scored [s]."""


@dataclass
class ScoredLog:
    """One log, and estimators on it with the gyroscope as recorded."""

    flights: Flights
    """The log as one flight; its truth is NaN where it does not count."""
    truth: Array
    """True roll and pitch (T, 2) [rad]."""
    counted: NDArray[np.bool_]
    """Samples that count (T,)."""
    faults: tuple[SensorFault, ...]
    """Faults of its sensors that begin inside it."""
    unscorable: str = ""
    """Why nothing of it can be scored; empty where something can."""
    estimates: dict[str, Array] = field(default_factory=dict)
    """Estimator to roll and pitch (T, 2) [rad]."""
    beliefs: dict[str, Beliefs] = field(default_factory=dict)
    """Estimator that has models to what it believed of them."""
    comparison: Comparison | None = None
    """How estimators differ on a log without a true attitude, which has no rows in the table."""

    @cached_property
    def bias(self) -> GyroBias | None:
        """Mean bias of its gyroscope; None for a log without a true attitude."""
        if self.unscorable:
            return None
        return bias_by_truth(self.flights.gyro[0], self.flights.quat[0], self.flights.rate_hz)

    @property
    def counted_s(self) -> float:
        """Length of what counts [s]."""
        return int(self.counted.sum()) / self.flights.rate_hz

    @property
    def bias_text(self) -> str:
        """The bias of its gyroscope with its 95 % interval, and what of it is removed."""
        if self.bias is None:
            return "no true attitude"
        if not np.isfinite(self.bias.mean).all():
            return "gyro bias unknown"
        shown = ", ".join(f"{mean:+.2f} ± {half:.2f}" for mean, half in np.degrees(np.transpose(self.bias)))
        axes = [axis for axis, value in zip("xyz", self.bias.significant, strict=True) if value != 0.0]
        removed = f"{', '.join(axes)} removed" if axes else "not significant, nothing is removed"
        return f"gyro bias ({shown.replace('-', '−')}) °/s at 95 %: {removed}"

    def squares(self, name: str) -> Array:
        """Mean squared inclination error in each block of 10 s in which samples count, (blocks,) [deg²]."""
        squares = inclination_error(self.estimates[name], self.flights.truth[0]) ** 2
        width = round(LOW_PASS_S * self.flights.rate_hz)
        blocks = [squares[k : k + width] for k in range(0, len(squares), width)]
        return np.array([float(np.nanmean(block)) for block in blocks if np.isfinite(block).any()])

    def interval(self, name: str) -> Coverage:
        """How honest the interval of an estimator with beliefs is where the truth counts."""
        return self.beliefs[name].interval(self.truth[None], self.counted[None])


@dataclass
class LogScores(Evaluation):
    """Estimators on all logs; the table has a row for each log, estimator and kind of bias."""

    logs: dict[str, ScoredLog] = field(default_factory=dict)
    tuning: str = ""
    """Which parameters the filters have, in a sentence."""

    def mean(self, estimator: str, kind: str) -> float:
        """Mean over the logs of the headline of the inclination RMSE [deg]; NaN where there is none."""
        return self.on_logs(kind)[self.headline].mean(axis=1).to_dict().get(estimator, np.nan)

    def on_logs(self, kind: str = RAW) -> pd.DataFrame:
        """Inclination RMSE of estimators by log [deg]: one of `KINDS`."""
        column = "silenced_inclination_deg" if kind == SILENCED else "inclination_rmse_deg"
        chosen = self.table.loc[self.table.bias == (KNOWN if kind == KNOWN else RAW)]
        return chosen.pivot(index="estimator", columns="log", values=column)

    @property
    def scored(self) -> list[str]:
        """Logs with a true attitude."""
        return [name for name, log in self.logs.items() if log.comparison is None]

    @property
    def compared(self) -> dict[str, Comparison]:
        """Logs without a true attitude, and how estimators differ on them."""
        return {name: log.comparison for name, log in self.logs.items() if log.comparison is not None}

    @property
    def faulty(self) -> list[str]:
        """Logs with a true attitude in which a fault of a sensor begins."""
        return [name for name in self.scored if self.logs[name].faults]

    @property
    def headline(self) -> list[str]:
        """Logs that means are over: those without a fault, or all where each has one."""
        return [name for name in self.scored if not self.logs[name].faults] or self.scored

    @cached_property
    def estimators(self) -> list[str]:
        """Estimators, the smallest raw error (without truth: force) first; those not ranked come last."""
        ran = [*self.table.estimator, *(name for log in self.logs.values() for name in log.estimates)]
        force = {name: sum(each.force.get(name, np.inf) for each in self.compared.values()) for name in ran}
        error = {name: np.nan_to_num(self.mean(name, RAW), nan=np.inf) for name in ran}
        return sorted(error, key=lambda name: (name in self.unranked, error[name], force[name]))

    @property
    def ranked(self) -> list[str]:
        """Estimators that are ranked, without the level guess."""
        return [name for name in self.estimators if name != LEVEL and name not in self.unranked]

    @property
    def tied(self) -> list[str] | None:
        """Ranked estimators whose squared error is not significantly larger than that of the best.

        Blocks of 10 s are compared in pairs; None if there are fewer than four.
        """
        best, *others = self.ranked
        squares = {name: self._squares(name) for name in self.ranked}
        if others and len(squares[best]) < FEWEST:
            return None
        return [name for name in others if not is_larger(squares[name], squares[best])]

    def _squares(self, name: str) -> Array:
        return np.concatenate([self.logs[log].squares(name) for log in self.headline])

    @cached_property
    def unranked(self) -> dict[str, str]:
        """Estimators that are not ranked, and why: a reference, or the first flaw found on any log."""
        raw = self.table[(self.table.bias == RAW) & (self.table.flaw != "")]
        flaws = dict(zip(raw.estimator[::-1], raw.flaw[::-1], strict=True))
        flaws |= {name: flaw for found in self.compared.values() for name, flaw in found.flaws.items()}
        return flaws | dict.fromkeys(self.table.estimator[self.table.reference], "receives the true attitude")


def score_logs(
    logs: Sequence[xr.Dataset],
    estimators: Sequence[str] | Mapping[str, AttitudeEstimator] = (),
    *,
    within_deg: float = 45.0,
    skip_s: float = SKIP_S,
    progress: Progress = lambda *_: None,
) -> LogScores:
    """Run estimators over logs, each from an unknown attitude, with the raw gyroscope and without its bias.

    Of the bias is removed what differs significantly from zero. Of a log without a true attitude estimators
    are compared with each other and with its forces.

    Args:
        logs: From `quadsim.logs.read_log`.
        estimators: Names, or estimators under the names they are to have; none: `default_names`.
        within_deg: Largest true inclination that is scored [deg].
        skip_s: Time at the start that is not scored [s].
        progress: Called before every estimator on every log.

    Raises:
        ValueError: Unknown estimators, two logs of one name, or a log of which nothing can be scored; before
            anything is run. Where every estimator fails on every log, or on one without a true attitude.
    """
    scores = LogScores(logs={str(log.attrs["source"]): prepared(log, within_deg, skip_s) for log in logs})
    if len(scores.logs) < len(logs):
        raise ValueError(f"logs must differ in name: {', '.join(str(log.attrs['source']) for log in logs)}")
    for title, one in scores.logs.items():
        if one.unscorable not in ("", NO_ATTITUDE):
            raise ValueError(f"{title}: nothing to score: {one.unscorable}")
    chosen, rows = estimators or default_names(), []
    for k, (title, one) in enumerate(scores.logs.items()):
        made = chosen if isinstance(chosen, Mapping) else made_of(chosen, one.flights.rate_hz)
        own = []
        for done, (name, est) in enumerate(made.items(), k * len(made)):
            progress(done, len(logs) * len(made), name)
            own += _rows(name, est, one)
        if missing := max(row.get("missing", 0) for row in own):
            logger.warning(
                "%s: %d of %d samples are missing or beyond any sensor's range; estimators go on from their "
                "prediction", title, missing, len(one.counted),
            )  # fmt: skip
        if one.unscorable:
            flaws = {row["estimator"]: row["flaw"] for row in own if row["flaw"]}
            good = {name: each[one.counted] for name, each in one.estimates.items() if name not in flaws}
            if not good:
                said = "; ".join(f"{name} {flaw}" for name, flaw in flaws.items())
                raise ValueError(f"{title}: no estimator ran: {said}")
            gyro, accel = (each[0, one.counted] for each in (one.flights.gyro, one.flights.accel))
            one.comparison = compare(good, gyro, accel, one.flights.rate_hz, flaws)
            continue
        level = errors_of(np.zeros_like(one.flights.truth), one.flights.truth)
        level |= {"estimator": LEVEL, "reference": False, "flaw": ""}
        faults = "; ".join(fault.name for fault in one.faults)
        of_log = {"log": title, "initial": "unknown", "scored_s": one.counted_s, "faults": faults}
        rows += [of_log | row for row in ([level | {"bias": which} for which in (RAW, KNOWN)] + own)]
    scores.table = pd.DataFrame(rows, columns=[each for each in COLUMNS if not each.startswith(OF_DATASETS)])
    if not any(log.estimates for log in scores.logs.values()):
        said = "; ".join(f"{name} {flaw}" for name, flaw in scores.unranked.items())
        raise ValueError(f"no estimator ran: {said}")
    return scores


def prepared(log: xr.Dataset, within_deg: float = 45.0, skip_s: float = SKIP_S) -> ScoredLog:
    """A log before anything is run; without an attitude the gyroscope's turns stand in for the truth.

    Args:
        log: From `quadsim.logs.read_log`.
        within_deg: Largest true inclination that is scored [deg].
        skip_s: Time at the start that is not scored [s].
    """
    flights = load_flights([log])
    truth, readings = flights.truth[0], np.isfinite(flights.gyro[0] + flights.accel[0]).all(axis=1)
    started = log["time"].to_numpy() >= skip_s
    tilt = np.nan_to_num(inclination_error(truth, np.zeros_like(truth)), nan=np.inf)
    counted, unscorable = np.ones(len(truth), bool), ""
    for lacking, holds in {
        f"nothing is known after the first {skip_s:g} s, which are not scored": started,
        NO_ATTITUDE: np.isfinite(truth).all(axis=1),
        "gyroscope and accelerometer are missing where the attitude is known": readings,
        "it marks no such sample for scoring": log["scored"].to_numpy()[0],
        f"it is tilted by more than {within_deg:g}° all the time (--within)": tilt <= within_deg,
    }.items():
        counted = counted & holds
        unscorable = unscorable or ("" if counted.any() else lacking)
    shown = truth
    if unscorable == NO_ATTITUDE:
        counted, shown = started & readings, motion(flights.gyro[0], flights.rate_hz)
        if not counted.any():
            unscorable = f"it has neither attitude nor readings after the first {skip_s:g} s"
    masked = replace(flights, truth=np.where(counted[:, None], shown, np.nan)[None])
    return ScoredLog(masked, truth, counted, log.attrs["log"].sensor_faults, unscorable)


def default_names(vehicle_known: bool = False) -> list[str]:
    """Estimators scored unless others are asked for: not filterpy's, ekf-drag only with a known vehicle."""
    return [
        name
        for name in names()
        if name != "truth" and name not in FILTERPY and (vehicle_known or not needs_vehicle(name))
    ]


def _rows(name: str, est: AttitudeEstimator, log: ScoredLog) -> list[dict[str, Any]]:
    """Run an estimator on a log; the estimate by the raw gyroscope, and its beliefs, go to the log."""
    flights, rows, offsets = log.flights, [], {RAW: np.zeros(3)}
    if log.bias is None and receives_truth(est):
        refused = ValueError("the log has no true attitude")
        return [failed(name, est, refused) | {"bias": RAW, "flaw": "receives the true attitude"}]
    if log.bias is not None and np.isfinite(log.bias.mean).all():
        offsets[KNOWN] = log.bias.significant
    for bias, offset in offsets.items():
        readings = flights.readings._replace(gyro=flights.gyro - offset)
        silence = bias == RAW and log.bias is not None
        try:
            estimate, row = assessed(name, est, replace(flights, readings=readings), silence=silence)
        except ValueError as error:
            rows.append(failed(name, est, error) | {"scored_s": 0.0, "bias": bias})
            continue
        rows.append(row | {"bias": bias})
        if bias == RAW:
            log.estimates[name] = estimate[0]
            if believed := beliefs(est, flights.gyro, flights.accel, **flights.readings.others):
                log.beliefs[name] = believed
    return rows
