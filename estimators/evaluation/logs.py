"""Evaluation of estimators on recorded logs: inclination errors, compared with a level guess.

The score is the RMS inclination error over samples that meet these conditions: attitude and readings are
known, the log marks the sample (`scored`), the first seconds have passed, and the inclination is below a
limit.
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
from .without_truth import FEWEST, LEVEL, LOW_PASS_S, Comparison, compare, gyro_angle, is_larger

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)

RAW, KNOWN, SILENCED = KINDS = "raw", "known", "silenced"
"""Kinds of error: with the gyroscope as recorded, with its significant mean bias subtracted, and of the
silenced network with the gyroscope as recorded."""
OF_DATASETS = ("median", "sd", "mean_low", "mean_high", "behind", "settle", "unranked", "tied")
"""Prefixes of the columns that compare the flights of a dataset; they do not apply to logs."""
NO_ATTITUDE = "it has no attitude"
"""Reason why a log is compared instead of scored."""
SKIP_S = 3.0
"""Time at the start that is not scored [s]."""


@dataclass
class ScoredLog:
    """One log with the estimates from the gyroscope as recorded."""

    flights: Flights
    """The log as one flight; the truth is NaN for samples that are not scored."""
    truth: Array
    """True roll and pitch (T, 2) [rad]."""
    counted: NDArray[np.bool_]
    """Scored samples (T,)."""
    faults: tuple[SensorFault, ...]
    """Sensor faults that begin during the log."""
    unscorable: str = ""
    """Why no sample can be scored; empty if some can."""
    estimates: dict[str, Array] = field(default_factory=dict)
    """Roll and pitch (T, 2) [rad] by estimator."""
    beliefs: dict[str, Beliefs] = field(default_factory=dict)
    """Model probabilities of estimators that have models."""
    comparison: Comparison | None = None
    """Comparison of estimators on a log without a true attitude, which has no rows in the table."""

    @cached_property
    def bias(self) -> GyroBias | None:
        """Mean bias of the gyroscope; None for a log without a true attitude."""
        if self.unscorable:
            return None
        return bias_by_truth(self.flights.gyro[0], self.flights.quat[0], self.flights.rate_hz)

    @property
    def counted_s(self) -> float:
        """Total duration of the scored samples [s]."""
        return int(self.counted.sum()) / self.flights.rate_hz

    @property
    def bias_text(self) -> str:
        """The gyroscope bias with its 95 % interval, and the part that is removed."""
        if self.bias is None:
            return "no true attitude"
        if not np.isfinite(self.bias.mean).all():
            return "gyro bias unknown"
        shown = ", ".join(f"{mean:+.2f} ± {half:.2f}" for mean, half in np.degrees(np.transpose(self.bias)))
        axes = [axis for axis, value in zip("xyz", self.bias.significant, strict=True) if value != 0.0]
        removed = f"{', '.join(axes)} removed" if axes else "not significant, nothing is removed"
        return f"gyro bias ({shown.replace('-', '−')}) °/s at 95 %: {removed}"

    def squares(self, name: str) -> Array:
        """Return the mean squared inclination error of each scored block of 10 s, (blocks,) [deg²]."""
        squares = inclination_error(self.estimates[name], self.flights.truth[0]) ** 2
        width = round(LOW_PASS_S * self.flights.rate_hz)
        blocks = [squares[k : k + width] for k in range(0, len(squares), width)]
        return np.array([float(np.nanmean(block)) for block in blocks if np.isfinite(block).any()])

    def interval(self, name: str) -> Coverage:
        """Return the coverage of an estimator's interval over scored samples."""
        return self.beliefs[name].interval(self.truth[None], self.counted[None])


@dataclass
class LogScores(Evaluation):
    """Scores on all logs. The table has a row for each log, estimator and kind of bias."""

    logs: dict[str, ScoredLog] = field(default_factory=dict)
    tuning: str = ""
    """Description of the parameters of the filters, in a sentence."""

    def mean(self, estimator: str, kind: str) -> float:
        """Return the mean inclination RMSE over the logs of the headline [deg]; NaN if there is none."""
        return self.on_logs(kind)[self.headline].mean(axis=1).to_dict().get(estimator, np.nan)

    def on_logs(self, kind: str = RAW) -> pd.DataFrame:
        """Return the inclination RMSE of estimators by log, for one of `KINDS` [deg]."""
        column = "silenced_inclination_deg" if kind == SILENCED else "inclination_rmse_deg"
        chosen = self.table.loc[self.table.bias == (KNOWN if kind == KNOWN else RAW)]
        return chosen.pivot(index="estimator", columns="log", values=column)

    @property
    def scored(self) -> list[str]:
        """Logs with a true attitude."""
        return [name for name, log in self.logs.items() if log.comparison is None]

    @property
    def compared(self) -> dict[str, Comparison]:
        """Logs without a true attitude, and the comparison of estimators on them."""
        return {name: log.comparison for name, log in self.logs.items() if log.comparison is not None}

    @property
    def faulty(self) -> list[str]:
        """Logs with a true attitude during which a sensor fault begins."""
        return [name for name in self.scored if self.logs[name].faults]

    @property
    def headline(self) -> list[str]:
        """Logs over which means are computed: those without a fault, or all if every log has one."""
        return [name for name in self.scored if not self.logs[name].faults] or self.scored

    @cached_property
    def estimators(self) -> list[str]:
        """Estimators in order of raw errors, or of forces without truth; unranked ones come last."""
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
        """Ranked estimators that are tied with the best; None if there are fewer than four blocks.

        Squared errors are compared over blocks of 10 s, in pairs.
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
        """Estimators that are not ranked, with the reason: a reference, or the first flaw on any log."""
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
    """Score estimators on logs from an unknown start, with the raw gyroscope and with its bias removed.

    Only the part of the bias that differs significantly from zero is removed. On a log without a true
    attitude, estimators are compared with each other and with the specific force.

    Args:
        logs: Logs from `quadsim.logs.read_log`.
        estimators: Names of estimators, or a mapping from names to estimators; by default, `default_names`.
        within_deg: Largest true inclination that is scored [deg].
        skip_s: Time at the start that is not scored [s].
        progress: Called before every estimator on every log.

    Raises:
        ValueError: Before running: an estimator is unknown, two logs have the same name, or a log has no
            sample to score. After running: every estimator failed on every log, or on a log without a true
            attitude.
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
    """Prepare a log for scoring. Without an attitude, rotations of the gyroscope replace the truth.

    Args:
        log: Log from `quadsim.logs.read_log`.
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
        counted, shown = started & readings, gyro_angle(flights.gyro[0], flights.rate_hz)
        if not counted.any():
            unscorable = f"it has neither attitude nor readings after the first {skip_s:g} s"
    masked = replace(flights, truth=np.where(counted[:, None], shown, np.nan)[None])
    return ScoredLog(masked, truth, counted, log.attrs["log"].sensor_faults, unscorable)


def default_names(vehicle_known: bool = False) -> list[str]:
    """Return the default estimators: all but filterpy's, and ekf-drag only with a known vehicle."""
    return [
        name
        for name in names()
        if name != "truth" and name not in FILTERPY and (vehicle_known or not needs_vehicle(name))
    ]


def _rows(name: str, est: AttitudeEstimator, log: ScoredLog) -> list[dict[str, Any]]:
    """Run an estimator on a log; return its rows, and store estimate and model probabilities in the log."""
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
