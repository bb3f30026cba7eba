"""What was found in a log, and the sentences that say what is wrong with it and how it is corrected."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..runs.console import print_table, say
from .cleaning import LONGEST_GAP_S
from .log_faults import SensorFault
from .mounting import MeanForce, Rest
from .recording import TruthAxes, mount_text
from .thresholds import CHECK
from .truth import Alignment

REST_TURN = np.pi / 2
"""Turn of the vertical by the gyroscope, at rest, that no bias explains [rad]."""
UNITS = {
    "accel": {"g": 1 / 9.81, "mg": 1e3 / 9.81},
    "gyro": {"deg/s": 180 / np.pi, "rad/s": np.pi / 180},
}
"""Units that a sensor's readings are mistaken in, and the factor by which they are then wrong."""
DOWNWARD = (
    'it points down: frame = "frd" for forward-right-down axes in north-east-down, or accel.negate = true '
    "for a log of gravity in place of specific force"
)
"""Reported where the mean force is upside down."""
UNSCORED = "no attitude in this log: it can be run, not scored"
FAILING = "a calibration does not correct a sensor that fails: look at its supply, mount and wiring"
"""Advice where a fault begins inside the log."""
AXES = [f"the {sensor}'s {axis}" for sensor in ("gyroscope", "accelerometer") for axis in "xyz"]


@dataclass(frozen=True)
class LogReport:
    """What was found in a log."""

    format: str
    truth: str
    truth_axes: TruthAxes
    """Axes whose attitude the truth is."""
    path: str
    """The file, as it was given."""
    notes: tuple[str, ...]
    parts: int
    """Parts into which gaps of more than half a minute cut the log; the longest is the one that was read."""
    samples: int
    duration_s: float
    source_rate_hz: float
    jitter_ms: float
    """Standard deviation of the time between samples, gaps and lost samples left out."""
    gaps: int
    gap_s: float
    """Total length of what is missing in them [s]."""
    longest_gap_s: float
    lost: int
    """Single samples lost, which were interpolated."""
    missing: int
    """Samples that are not finite numbers."""
    stamps_back: int
    """Samples left out because their stamp is not after the one before."""
    clock_back_ms: int
    """How far the clock goes back at most [ms]."""
    repeated: int
    """Samples equal to the one before on all six axes."""
    still: tuple[str, ...]
    """Sensors, or axes of one, that read the same number all the time."""
    sensor_faults: tuple[SensorFault, ...]
    """Faults that begin inside the log."""
    truth_rate_hz: float
    truth_share: float
    """Share of the even samples at which the attitude is known."""
    truth_norm: float | None
    """Median length of the truth's quaternions as recorded."""
    gravity: tuple[float, ...] | None
    """Mean specific force, turned to the world by the truth [m/s²]: (0, 0, 9.81) where frames agree."""
    aligned: Alignment | None
    """How the truth turns beside the gyroscope; None where there is too little motion."""
    level: MeanForce | None
    """Where the specific force points; None where no second is complete, or a truth of the body shows it
    better."""
    rest: Rest | None
    """The stretch at rest over which the vertical turns most by the gyroscope."""
    weight: float
    """Median length of the specific force [m/s²]: near 9.8 in flight and in the hand."""
    upright: float
    """Its mean along body z, over that length: near 1 in a flight."""
    vibration: float
    """Root mean square of the specific force above 20 Hz [m/s²]."""
    filter_hz: float | None
    """−6 dB corner of the anti-alias filter; None where there was none to apply."""

    @property
    def faults(self) -> list[str]:
        """Why scores on this log would mean nothing, in sentences; none where all is well."""
        return [*self._reading_faults(), *self._rate_faults(), *self._frame_faults()]

    @property
    def warnings(self) -> list[str]:
        """What a user ought to look into, in sentences."""
        damage = [note for note in self.notes if note.startswith("damaged: ")]
        return [*self.faults, *damage, *self._sample_warnings(), *self._frame_warnings()]

    def _reading_faults(self) -> Iterator[str]:
        """Constant readings, and a specific force of another length or direction than gravity's."""
        yield from (f"{sensor} reads the same number all the time" for sensor in self.still)
        low, high = CHECK.weights
        if "the accelerometer" not in self.still and not low <= self.weight <= high:
            force = f"the specific force has a median of {self.weight:.4g} m/s²"
            yield f"{force}, and gravity alone is 9.8: {_unit_of('accel', self.weight / 9.81)}"
        elif self.truth == "none" and self.upright < CHECK.upright:
            mend = DOWNWARD if self.upright < -CHECK.upright else f"is the frame FLU? {self._mend}"
            yield (
                f"body z carries {self.upright:.2f} of the specific force, and in a flight it carries nearly "
                f"all: {mend}"
            )

    def _rate_faults(self) -> Iterator[str]:
        """A gyroscope in another unit: by its slope over the truth, or where there is none at rest."""
        if self.aligned is None:
            seconds, rate = self.rest or (0, 0.0)
            if rate > CHECK.rest_rate and seconds * rate > REST_TURN:
                turn = f"across the vertical, which would turn it by {np.degrees(seconds * rate):.0f}°"
                read = f"at rest for {seconds} s, the gyroscope reads {rate:.3g} rad/s {turn}"
                yield f"{read}: {_unit_of('gyro', 180 / np.pi)}"
            return
        low, high = CHECK.slopes
        slope, r = self.aligned.slope, max(self.aligned.rotated_agreement, 1e-3)
        if "the gyroscope" in self.still:
            return
        if slope > CHECK.no_turn:
            yield "the truth hardly turns where the gyroscope does"
        elif r * slope > high or slope / r < low:  # whatever the noise of both
            yield (
                f"the gyroscope reads {slope:.3g} times the rate at which the truth turns (slope): "
                f"{_unit_of('gyro', slope, r)}"
            )

    def _frame_faults(self) -> Iterator[str]:
        """A truth that is no attitude, or of other axes than the readings."""
        if self.truth_norm is not None and abs(self.truth_norm - 1.0) > CHECK.unit_norm:
            yield f"the truth's quaternions have a length of {self.truth_norm:.3g}, not 1"
        found = self.aligned and self.aligned.turned
        if found and not self._agrees:
            fault = f"the truth does not turn as the gyroscope does (correlation {found.agreement:.2f})"
            by = f"; with the IMU rotated by {found.rotation_deg:.0f}° it does ({found.rotated:.2f})"
            mounting = f"{by}: {self._mend_of_truth}" if found.rotated > CHECK.mounted_agreement else ""
            yield f"{fault}: look at frame and mount{mounting}"
        elif found and min(found.axes) < CHECK.agreement:
            worst = int(np.argmin(found.axes))
            yield (
                f"the gyroscope's {'xyz'[worst]} does not read how the truth turns about that axis "
                f"(correlation {found.axes[worst]:.2f}): look at frame and mount"
            )
        if self._off_gravity > CHECK.gravity_wrong:
            yield self._where_gravity

    def _sample_warnings(self) -> Iterator[str]:
        """Samples that are missing, left out or doubtful."""
        if self.parts > 1:
            cut = f"gaps of more than {LONGEST_GAP_S:g} s cut this log into {self.parts} parts"
            yield f"{cut}: the longest was read"
        if self.stamps_back:
            text = f"{self.stamps_back} samples do not follow the one before in time: left out"
            if self.clock_back_ms > CHECK.clock_back_ms:
                back = f"{self.clock_back_ms / 1e3:.1f} s"
                text += f"; the clock goes back by {back}, and the log jumps where it resumes"
            yield text
        if self.gaps:
            count = "1 gap" if self.gaps == 1 else f"{self.gaps} gaps"
            longest = f"{self.gap_s:.2f} s in all, the longest {self.longest_gap_s:.3f} s"
            yield f"{count}, {longest}: left out of scores"
        if self.lost:
            yield f"{self.lost} single samples lost: interpolated"
        yield from (fault.sentence for fault in self.sensor_faults)
        if self.source_rate_hz < CHECK.slow_hz:
            rate, fastest = self.source_rate_hz, 0.4 * self.source_rate_hz
            yield f"sampled at {rate:.0f} Hz: motion above {fastest:.0f} Hz is not in this log"
        if self.repeated:
            yield f"{self.repeated} samples repeat the one before"
        if self.missing:
            yield f"{self.missing} samples or stamps are not numbers, or beyond any sensor's range: left out"

    def _frame_warnings(self) -> Iterator[str]:
        """A truth that is missing or late, or an IMU that is mounted in another way."""
        found, rest = self.aligned, self.rest
        if self.truth == "none":
            yield UNSCORED
            if rest and rest.seconds >= CHECK.least_rest_s and rest.rate > np.radians(CHECK.large_bias_deg):
                rate = f"{np.degrees(rest.rate):.1f} °/s across the vertical"
                failing = any(fault.sensor == "gyroscope" for fault in self.sensor_faults)
                mend = FAILING if failing else f"`quadsim identify {self.path} --still`"
                yield f"at rest for {rest.seconds} s, the gyroscope reads {rate}, a large bias: {mend}"
            if self.vibration > CHECK.vibration:
                yield (
                    f"the accelerometer vibrates by {self.vibration:.1f} m/s² RMS above 20 Hz, and above "
                    f"{CHECK.vibration:g} m/s² its mean may be shifted"
                )
        elif self.truth_share == 0.0:
            yield "the true attitude is known at no sample of the IMU: are both on one clock?"
        if CHECK.gravity_tolerance < self._off_gravity <= CHECK.gravity_wrong:
            yield self._where_gravity
        if not self.faults:
            turned = found and found.turned
            if turned and turned.gain > CHECK.mounted_gain and turned.common > CHECK.mounted_agreement:
                gyro = f"the gyroscope rotated by {turned.rotation_deg:.0f}°"
                yield f"the truth turns as {gyro} does: {self._mend_of_truth}"
            if self.tilted:
                yield self.tilted
        if found and abs(found.delay_s) > CHECK.delay_tolerance_s and self._agrees:
            ms, which = abs(found.delay_s) * 1e3, "late" if found.delay_s > 0 else "early"
            yield f"the truth is {ms:.0f} ms {which}: scores count that as errors of the estimators"

    @property
    def _agrees(self) -> bool:
        return self.aligned is None or self.aligned.turned.agreement >= CHECK.agreement

    @property
    def _off_gravity(self) -> float:
        """Distance of the mean force in the world from gravity [m/s²]; 0 where it is not known."""
        return float(np.linalg.norm(np.subtract(self.gravity or (0.0, 0.0, 9.81), (0.0, 0.0, 9.81))))

    @property
    def _where_gravity(self) -> str:
        x, y, z = self.gravity or (0.0, 0.0, 9.81)
        mend = DOWNWARD if z < -2 * abs(x) - 2 * abs(y) else f"look at frame and mount; {self._mend_of_truth}"
        return (
            f"frames disagree: turned to the world, the specific force averages ({x:.1f}, {y:.1f}, {z:.1f}) "
            f"m/s², not (0, 0, 9.8): {mend}"
        )

    @property
    def _mend(self) -> str:
        far = self.level is not None and self.level.tilt_deg > CHECK.far_deg
        about = f', about --mount "{mount_text(self.level.mount)}"' if self.level and far else ""
        return f"`quadsim report {self.path} --find-mount best` estimates the --mount that corrects it{about}"

    @property
    def tilted(self) -> str:
        """Of a mean force that is far from body z, how far and what corrects it; else empty."""
        mean = self.level
        if mean is None or mean.tilt_deg <= CHECK.tilt_deg + 2 * mean.sd_deg:
            return ""
        return f"the mean specific force is {mean.tilt_deg:.1f}° from body z: {self._mend}"

    @property
    def _mend_of_truth(self) -> str:
        """The same where the truth is the body's; a mount rotates one of the IMU with it."""
        return self._mend if self.truth_axes == "body" else "is the truth the IMU's (truth_axes)?"


def show_report(path: Path, report: LogReport) -> None:
    """Print what a log holds, what is odd about it, and what was taken for the truth."""
    rows = {
        "format": report.format,
        "samples": f"{report.samples} in {report.duration_s:.2f} s",
        "sample rate": f"{report.source_rate_hz:.2f} Hz, {report.jitter_ms:.3f} ms SD from step to step",
        "brought to": "200 Hz, "
        + (f"low-pass at {report.filter_hz:g} Hz" if report.filter_hz else "nothing to filter"),
        "gaps": f"{report.gaps}, {report.gap_s:.3f} s in all, longest {report.longest_gap_s:.3f} s",
        "single samples lost": report.lost,
        "stamps not after the last": report.stamps_back,
        "repeated samples": report.repeated,
        "samples not numbers": report.missing,
        "truth": report.truth,
        "truth known": f"{100 * report.truth_share:.1f} % of the time, at {report.truth_rate_hz:.1f} Hz",
    }
    if report.gravity is not None:
        x, y, z = report.gravity
        rows["mean force in the world"] = f"({x:.2f}, {y:.2f}, {z:.2f}) m/s²"
    if (found := report.aligned) is not None:
        rows["truth late by"] = f"{1e3 * found.delay_s:.1f} ms, correlation {found.agreement:.3f}"
        rows["gyroscope over truth"] = f"{found.slope:.3f}"
    share = f"{100 * report.upright:.0f} % of it along body z"
    rows["specific force"] = f"median {report.weight:.2f} m/s², {share}"
    print_table([*rows.items(), *(("note", note) for note in report.notes)])
    for warning in report.warnings:
        say(f"! {warning}")
    count = len(report.warnings)
    verdict = "nothing odd" if not count else f"{count} {'thing' if count == 1 else 'things'} to know"
    say(f"{path}: {report.duration_s:.1f} s, {verdict}")


def _unit_of(sensor: str, ratio: float, r: float = 1.0) -> str:
    """The unit that a factor looks like that is uncertain between r and 1/r times itself."""
    for unit, factor in UNITS[sensor].items():
        if abs(np.log(ratio / factor)) < 0.25 - np.log(r):
            return f'is it in {unit} ({sensor}.unit = "{unit}")?'
    return "look at its unit, and at that of the stamps"
