"""Estimators on recorded logs: errors as benchmarks of inertial sensors count them, beside a level guess.

Inclination error, as a root mean square over the samples that count: the attitude and the readings are known,
the log marks the sample (`scored`), the first seconds are over, and the vehicle is tilted less than a limit.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Unpack

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator, OtherSensors, receives_truth
from quadsim.logs.faults import SensorFault
from quadsim.logs.truth_bias import bias_by_truth
from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.files import write_csv

from ..appearance import looks
from ..metrics import absolute_error, flaw_of, inclination_error, share_without_number
from ..registry import FILTERPY, names, needs_vehicle
from ..running import missing_samples, require_same, run_quietly, streamed_once
from .beliefs import Beliefs, beliefs
from .comparison import made_of, silenced_twin
from .flights import other_sensors
from .without_truth import LEVEL, Comparison, compare, motion

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)
Progress = Callable[[int, int, str], None]

RAW, KNOWN = "raw", "known"
"""Gyroscope as it reads, and with its mean bias over the log taken off, where that is significant."""
NO_ATTITUDE = "it has no attitude"
"""Why a log is compared in place of scored."""
SKIP_S = 3.0
"""Time at the start that is not scored [s]."""
FAULT_COLOURS = {
    "bias jump": "#cc79a7",
    "stuck axis": "#7f7f7f",
    "saturation": "#e69f00",
    "vibration": "#d55e00",
}
"""Kind of fault to the colour of its band."""
LISTED = 6
"""Estimators drawn in a picture, the best first."""


@dataclass(frozen=True)
class LogRow:
    """One estimator on one log."""

    log: str
    estimator: str
    bias: str
    """raw or known."""
    inclination_rmse_deg: float
    """NaN where no sample counts."""
    mean_deg: float
    """Mean absolute error of roll and of pitch, pooled, over the same samples."""
    scored_s: float
    """Length of what is scored [s]."""
    without_number: float
    """Share of the estimates scored that are no finite number or no angle, each counted as 180°."""
    silenced_deg: float = float("nan")
    """Of a network: inclination RMSE with its output weights at zero; NaN for other estimators."""
    reference: bool = False
    """Whether it receives the true attitude."""
    flaw: str = ""
    """What is wrong with its estimates, or why it has none; empty if nothing."""
    faults: str = ""
    """Faults of the sensors that begin inside the log; empty if none is found."""


@dataclass
class LogScores:
    """All rows, and what the pictures are drawn from."""

    rows: list[LogRow] = field(default_factory=list)
    gyro_bias: dict[str, Array] = field(default_factory=dict)
    """Log to the mean bias of its gyroscope (3,) [rad/s]; NaN where the truth does not tell."""
    bias_removed: dict[str, Array] = field(default_factory=dict)
    """Log to what of it is significant and is removed (3,) [rad/s]; 0 on other axes, NaN where not known."""
    bias_interval: dict[str, Array] = field(default_factory=dict)
    """Log to half the width of the bias's 95 % interval (3,) [rad/s]."""
    time_s: dict[str, Array] = field(default_factory=dict)
    truth: dict[str, Array] = field(default_factory=dict)
    """Log to true roll and pitch (T, 2) [rad]."""
    counted: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    """Log to the samples that count (T,)."""
    estimates: dict[tuple[str, str], Array] = field(default_factory=dict)
    """(log, estimator) to raw roll and pitch (T, 2) [rad]."""
    beliefs: dict[tuple[str, str], Beliefs] = field(default_factory=dict)
    """(log, estimator) to the models that an estimator believed, raw; only of estimators that have models."""
    comparisons: dict[str, Comparison] = field(default_factory=dict)
    """Log without a true attitude to how its estimators differ; it has no rows."""
    tuning: str = ""
    """Which parameters the filters have, in a sentence."""
    faults: dict[str, tuple[SensorFault, ...]] = field(default_factory=dict)
    """Log to the faults of its sensors that begin inside it."""

    def write_csv(self, path: Path) -> None:
        """Write the rows; the header is the fields of `LogRow`."""
        write_csv(path, self.rows)

    def bias_text(self, log: str) -> str:
        """The bias of a log's gyroscope with its 95 % interval, and what of it is removed."""
        if log in self.comparisons:
            return "no true attitude"
        bias, half = np.degrees(self.gyro_bias[log]), np.degrees(self.bias_interval[log])
        if not np.isfinite(bias).all():
            return "gyro bias unknown"
        shown = ", ".join(f"{b:+.2f} ± {h:.2f}" for b, h in zip(bias, half, strict=True))
        axes = [axis for axis, value in zip("xyz", self.bias_removed[log], strict=True) if value != 0.0]
        removed = f"{', '.join(axes)} removed" if axes else "not significant, nothing is removed"
        return f"gyro bias ({shown}) °/s at 95 %: {removed}"

    def mean(self, estimator: str, bias: str) -> float:
        """Mean over the logs of the headline of the inclination RMSE [deg]."""
        return _mean([row.inclination_rmse_deg for row in self._rows_of(estimator, bias)])

    def silenced(self, estimator: str) -> float:
        """The same of the network silenced, raw; NaN for others [deg]."""
        return _mean([row.silenced_deg for row in self._rows_of(estimator, RAW)])

    def _rows_of(self, estimator: str, bias: str) -> list[LogRow]:
        logs = self.headline
        return [r for r in self.rows if (r.estimator, r.bias) == (estimator, bias) and r.log in logs]

    def on_log(self, log: str, estimator: str, bias: str) -> float:
        """Inclination RMSE of an estimator on one log [deg]; NaN where there is none."""
        key = (log, estimator, bias)
        return _mean([r.inclination_rmse_deg for r in self.rows if (r.log, r.estimator, r.bias) == key])

    @property
    def faulty(self) -> list[str]:
        """Logs with a true attitude in which a fault of a sensor begins."""
        return [log for log in self.scored if self.faults.get(log)]

    @property
    def headline(self) -> list[str]:
        """Logs that means are over: those without a fault, or all where each has one."""
        return [log for log in self.scored if not self.faults.get(log)] or self.scored

    @property
    def scored(self) -> list[str]:
        """Logs with a true attitude."""
        return [log for log in self.truth if log not in self.comparisons]

    @property
    def estimators(self) -> list[str]:
        """Estimators, the smallest raw error first; those that are not ranked come last."""
        ran = [*(row.estimator for row in self.rows), *(name for _, name in self.estimates)]
        found, unranked = list(dict.fromkeys(ran)), self.unranked
        error = {name: np.nan_to_num(self.mean(name, RAW), nan=np.inf) for name in found}
        return sorted(found, key=lambda name: (name in unranked, error[name]))

    @property
    def unranked(self) -> dict[str, str]:
        """Estimators that are not ranked, and why: a reference, or the first flaw found on any log."""
        flaws = {row.estimator: row.flaw for row in reversed(self.rows) if row.flaw and row.bias == RAW}
        flaws |= {name: flaw for each in self.comparisons.values() for name, flaw in each.flaws.items()}
        return flaws | {row.estimator: "receives the true attitude" for row in self.rows if row.reference}


def score_logs(
    logs: Sequence[xr.Dataset],
    estimators: Sequence[str] | Mapping[str, AttitudeEstimator] = (),
    *,
    within_deg: float = 45.0,
    skip_s: float = SKIP_S,
    progress: Progress | None = None,
) -> LogScores:
    """Run estimators over logs, each from an unknown attitude, with the raw gyroscope and without its bias.

    Of the bias is removed what differs significantly from zero.

    Args:
        logs: From `quadsim.logs.read_log`.
        estimators: Names, or estimators under the names they are to have; none: `default_names`.
        within_deg: Largest true inclination that is scored [deg].
        skip_s: Time at the start that is not scored [s].
        progress: Called before every run.

    Raises:
        ValueError: Unknown estimators, two logs of one name, or a log of which nothing can be scored; before
            anything is run. Where every estimator fails on every log.
    """
    progress = progress or (lambda *_: None)
    titles = [str(log.attrs["source"]) for log in logs]
    if len(set(titles)) < len(titles):
        raise ValueError(f"logs must differ in name: {', '.join(titles)}")
    chosen = estimators or default_names()
    scores, done = LogScores(), 0
    for title, log in zip(titles, logs, strict=True):
        if reason := unscorable(log, within_deg=within_deg, skip_s=skip_s):
            raise ValueError(f"{title}: nothing to score: {reason}")
    for title, log in zip(titles, logs, strict=True):
        rate = float(log.attrs["rate_hz"])
        made = chosen if isinstance(chosen, Mapping) else made_of(chosen, rate)
        gyro, accel, quat = (log[name].to_numpy().astype(float) for name in ("gyro", "accel", "quat"))
        truth, others = roll_pitch_from_quat(quat), other_sensors(log)
        scores.time_s[title], scores.truth[title] = log["time"].to_numpy(), truth[0]
        scores.faults[title] = faults_of(log)
        scores.counted[title] = counted = np.logical_and.reduce(
            list(_conditions(log, within_deg, skip_s).values())
        )
        found = bias_by_truth(gyro[0], quat[0], rate)
        scores.gyro_bias[title], scores.bias_interval[title] = found
        scores.bias_removed[title] = bias = found.significant
        for which in (RAW, KNOWN):
            scores.rows.append(_row(title, LEVEL, which, np.zeros_like(truth[0]), truth[0], counted, rate))
        skipped = 0
        for name, est in made.items():
            progress(done, len(logs) * len(made), name)
            for which, offset in ((RAW, np.zeros(3)), (KNOWN, bias)):
                nothing = LogRow(title, name, which, float("nan"), float("nan"), 0.0, 0.0)
                nothing = replace(nothing, reference=receives_truth(est))
                if not np.isfinite(offset).all():
                    scores.rows.append(nothing)
                    continue
                try:
                    estimate = _run(est, gyro - offset, accel, quat, **others)
                    skipped = max(skipped, missing_samples(est))
                except ValueError as error:
                    scores.rows.append(replace(nothing, flaw=f"did not run: {error}"))
                    continue
                row = _row(title, name, which, estimate[0], truth[0], counted, rate)
                flaw = flaw_of(estimate[0][counted], truth[0][counted])
                row = replace(row, reference=receives_truth(est), flaw=flaw)
                if which == RAW and (twin := silenced_twin(name, rate)) is not None:
                    without = _row(
                        title, name, which, run_quietly(twin, gyro, accel)[0], truth[0], counted, rate
                    )
                    row = replace(row, silenced_deg=without.inclination_rmse_deg)
                scores.rows.append(row)
                if which == RAW:
                    scores.estimates[title, name] = estimate[0]
                    if (believed := beliefs(est, gyro, accel, **others)) is not None:
                        scores.beliefs[title, name] = believed
            done += 1
        _say_missing(title, skipped, len(truth[0]))
    scores.rows = [
        replace(row, faults="; ".join(fault.name for fault in scores.faults[row.log])) for row in scores.rows
    ]
    if not scores.estimates:
        failed = [f"{name} {flaw}" for name, flaw in scores.unranked.items()]
        raise ValueError(f"no estimator ran: {'; '.join(failed)}")
    return scores


def compare_logs(
    scores: LogScores,
    logs: Sequence[xr.Dataset],
    estimators: Mapping[str, AttitudeEstimator],
    *,
    skip_s: float = SKIP_S,
    progress: Progress | None = None,
) -> None:
    """Run estimators over logs without a true attitude; their estimates and comparisons go to the scores.

    Args:
        scores: To add to.
        logs: From `quadsim.logs.read_log`.
        estimators: Estimators under the names they are to have; one that receives the truth is left out.
        skip_s: Time at the start that is not compared [s].
        progress: Called before every run.

    Raises:
        ValueError: A log has the name of another, ends before `skip_s`, or no estimator ran on it.
    """
    progress = progress or (lambda *_: None)
    for done, log in enumerate(logs):
        title, rate = str(log.attrs["source"]), float(log.attrs["rate_hz"])
        if title in scores.truth:
            raise ValueError(f"logs must differ in name: {title}")
        time = log["time"].to_numpy()
        gyro, accel = (log[name].to_numpy().astype(float) for name in ("gyro", "accel"))
        counted = np.asarray((time >= skip_s) & np.isfinite(gyro[0] + accel[0]).all(axis=1))
        if not counted.any():
            raise ValueError(f"{title}: nothing to compare: it has no readings after the first {skip_s:g} s")
        good, flaws, others, skipped = {}, {}, other_sensors(log), 0
        for k, (name, est) in enumerate(estimators.items()):
            progress(done * len(estimators) + k, len(logs) * len(estimators), name)
            if receives_truth(est):
                flaws[name] = "receives the true attitude"
                continue
            try:
                estimate = _run(est, gyro, accel, None, **others)[0]
                skipped = max(skipped, missing_samples(est))
            except ValueError as error:
                flaws[name] = f"did not run: {error}"
                continue
            scores.estimates[title, name] = estimate
            if flaw := flaw_of(estimate[counted], motion(gyro[0, counted], rate)):
                flaws[name] = flaw
                continue
            good[name] = estimate[counted]
            if (believed := beliefs(est, gyro, accel, **others)) is not None:
                scores.beliefs[title, name] = believed
        _say_missing(title, skipped, len(time))
        if not good:
            failed = [f"{name} {flaw}" for name, flaw in flaws.items()]
            raise ValueError(f"{title}: no estimator ran: {'; '.join(failed)}")
        scores.time_s[title], scores.counted[title] = time, counted
        scores.faults[title] = faults_of(log)
        scores.truth[title] = np.full((len(time), 2), np.nan)
        scores.comparisons[title] = compare(good, gyro[0, counted], accel[0, counted], rate, flaws)


def faults_of(log: xr.Dataset) -> tuple[SensorFault, ...]:
    """Faults of its sensors that begin inside a log from `quadsim.logs.read_log`."""
    return tuple(SensorFault(*fault) for fault in log.attrs.get("log", {}).get("sensor_faults", ()))


def unscorable(log: xr.Dataset, *, within_deg: float = 45.0, skip_s: float = SKIP_S) -> str | None:
    """Why no sample of a log can be scored; None where some can.

    Args:
        log: From `quadsim.logs.read_log`.
        within_deg: Largest true inclination that is scored [deg].
        skip_s: Time at the start that is not scored [s].
    """
    counted = np.ones(log.sizes["time"], bool)
    for reason, holds in _conditions(log, within_deg, skip_s).items():
        counted &= holds
        if not counted.any():
            return reason
    return None


def default_names(vehicle_known: bool = False) -> list[str]:
    """Estimators scored unless others are asked for: not filterpy's, ekf-drag only with a known vehicle."""
    return [
        name
        for name in names()
        if name != "truth" and name not in FILTERPY and (vehicle_known or not needs_vehicle(name))
    ]


def gyro_bias(gyro: Array, quat: Array, rate_hz: float) -> Array:
    """Mean of what a gyroscope reads above the rate at which the attitude turns.

    Args:
        gyro: (T, 3) [rad/s]; NaN where missing.
        quat: quat_WB (T, 4); NaN where not known.
        rate_hz: Samples per second.

    Returns:
        (3,) [rad/s]; NaN if fewer than a second of slow turns is known.
    """
    return bias_by_truth(gyro, quat, rate_hz).mean


def draw_log(scores: LogScores, log: str, within: tuple[float, float] | None = None) -> Figure:
    """True roll and pitch of a log with the best estimate, and a strip of error for each estimator.

    Of a log without a true attitude, roll and pitch by each estimator.

    Args:
        scores: From `score_logs`.
        log: Name of the log.
        within: Part of it to draw [s]; None for all.
    """
    time, truth, compared = scores.time_s[log], scores.truth[log], log in scores.comparisons
    part = slice(None) if within is None else slice(*np.searchsorted(time, within))
    shown = [name for name in scores.estimators if (log, name) in scores.estimates][:LISTED]
    strips = [] if compared else shown
    figure = Figure(figsize=(8.0, 3.6 + 0.75 * len(strips)), layout="constrained")
    ratios = [2.0, 2.0, *np.ones(len(strips))]
    panels = np.atleast_1d(figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios))
    styles = looks(shown)
    for k, axes in enumerate(panels[:2]):
        if not compared:
            axes.plot(time[part], np.degrees(truth[part, k]), color="black", lw=2.2, label="truth")
        for name in shown if compared else shown[:1]:
            best = np.degrees(scores.estimates[log, name][part, k])
            axes.plot(time[part], best, color=styles[name].colour, lw=1.0, label=name)
        axes.set_ylabel(("roll [°]", "pitch [°]")[k])
    panels[0].legend(ncols=2, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
    errors = {
        name: np.where(scores.counted[log], inclination_error(scores.estimates[log, name], truth), np.nan)[
            part
        ]
        for name in strips
    }
    known = np.concatenate([[1.0], *(error[np.isfinite(error)] for error in errors.values())])
    for axes, (name, error) in zip(panels[2:], errors.items(), strict=True):
        axes.fill_between(time[part], error, color=styles[name].colour, alpha=0.25, linewidth=0)
        axes.plot(time[part], error, color=styles[name].colour, lw=0.9)
        axes.set_ylim(0.0, 1.3 * float(np.quantile(known, 0.999)))
        axes.set_title(
            name, fontsize=9, fontweight="bold", loc="left", color=styles[name].colour, y=0.68, x=0.01
        )
    if strips:
        panels[2 + len(strips) // 2].set_ylabel("inclination error, where it counts [°]", y=1.0)
    panels[-1].set_xlabel("time [s]")
    panels[0].set_title(f"{log}, raw readings", fontsize=10, loc="left")
    for axes in panels:
        axes.grid(alpha=0.3)
        axes.margins(x=0)
    _shade(figure, panels, scores.faults.get(log, ()), (float(time[part][0]), float(time[part][-1])))
    return figure


def _shade(
    figure: Figure, panels: NDArray[np.object_], faults: Sequence[SensorFault], shown: tuple[float, float]
) -> None:
    """A band over all panels for each fault, one colour a kind, and a legend of them below."""
    bands = {}
    for fault in faults:
        start, end = max(fault.start_s, shown[0]), min(fault.end_s, shown[1])
        for axes in panels if start < end else ():
            bands[fault.name] = axes.axvspan(
                start, end, color=FAULT_COLOURS[fault.kind], alpha=0.25, linewidth=0
            )
    if bands:
        figure.legend(bands.values(), bands.keys(), loc="outside lower left", frameon=False, fontsize=8)


def _run(
    est: AttitudeEstimator, gyro: Array, accel: Array, quat: Array | None, **sensors: Unpack[OtherSensors]
) -> Array:
    """`run`, for a caller that says what is missing once for a log."""
    first = streamed_once(est, gyro, accel, **sensors)
    estimate = run_quietly(est, gyro, accel, quat=quat, **sensors)
    require_same(est, estimate, first)
    return estimate


def _say_missing(log: str, missing: int, samples: int) -> None:
    if missing:
        logger.warning(
            "%s: %d of %d samples are missing or beyond any sensor's range; estimators go on from their "
            "prediction",
            log, missing, samples,
        )  # fmt: skip


def _mean(values: Sequence[float]) -> float:
    """Mean of the values that are finite; NaN if none is."""
    known = np.array(values)[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def _conditions(log: xr.Dataset, within_deg: float, skip_s: float) -> dict[str, NDArray[np.bool_]]:
    """What a log lacks where a condition never holds, and the samples (T,) at which it holds."""
    one = log.isel(flight=0)
    truth = roll_pitch_from_quat(one["quat"].to_numpy().astype(float))
    tilt = inclination_error(truth, np.zeros_like(truth))
    scored = one["scored"].to_numpy() if "scored" in one else np.ones(len(truth), bool)
    readings = np.isfinite(np.hstack([one["gyro"].to_numpy(), one["accel"].to_numpy()])).all(axis=1)
    conditions = {
        f"nothing is known after the first {skip_s:g} s, which are not scored": one["time"].to_numpy()
        >= skip_s,
        NO_ATTITUDE: np.isfinite(truth).all(axis=1),
        "gyroscope and accelerometer are missing where the attitude is known": readings,
        "it marks no such sample for scoring": scored,
        f"it is tilted by more than {within_deg:g}° all the time (--within)": np.nan_to_num(tilt, nan=np.inf)
        <= within_deg,
    }
    return {reason: np.asarray(holds, bool) for reason, holds in conditions.items()}


def _row(
    log: str, name: str, bias: str, estimate: Array, truth: Array, counted: NDArray[np.bool_], rate: float
) -> LogRow:
    estimate, truth = estimate[counted], truth[counted]
    rmse = mean = float("nan")
    if counted.any():
        rmse = float(np.sqrt(np.mean(inclination_error(estimate, truth) ** 2)))
        mean = float(absolute_error(estimate, truth).mean())
    share = share_without_number(estimate, truth)
    return LogRow(log, name, bias, rmse, mean, float(counted.sum()) / rate, share)
