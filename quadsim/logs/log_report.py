"""What was found in a log, and the sentences that say what is wrong with it and how it is corrected."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..runs.console import print_table, say
from .cleaning import LONGEST_GAP_S
from .log_faults import SensorFault, fast_part
from .mounting import MeanForce, Rest
from .recording import OWN_ESTIMATE, Array, Recording, mount_text
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


@dataclass(frozen=True)
class LogReport:
    """What was found in a log."""

    log: Recording
    """What was read of it: its longest part, without the samples that were left out."""
    counts: Mapping[str, float]
    """Numbers of its stamps and samples: `parts` between gaps of more than half a minute, `samples`,
    `duration_s`, `source_rate_hz`, `jitter_ms` (standard deviation of the time between samples, without gaps
    and lost ones), `gaps`, what is missing in them (`gap_s`) and `longest_gap_s`, single samples `lost` and
    interpolated, samples `missing` that are not finite numbers, `stamps_back` that are not after the one
    before, `clock_back_ms` by which they go back at most, samples `repeated` on all six axes, `truth_rate_hz`
    and `truth_share`, the share of the even samples at which the truth is known."""
    sensor_faults: tuple[SensorFault, ...]
    """Faults that begin inside the log."""
    gravity: Array | None
    """Mean specific force, turned to the world by the truth (3,) [m/s²]: (0, 0, 9.81) where frames agree."""
    aligned: Alignment | None
    """How the truth turns beside the gyroscope; None where there is too little motion."""
    level: MeanForce | None
    """Where the specific force points; None where no second is complete, or a truth of the body shows it
    better."""
    rest: Rest | None
    """The stretch at rest over which the vertical turns most by the gyroscope."""
    filter_hz: float | None
    """−6 dB corner of the anti-alias filter; None where there was none to apply."""

    @cached_property
    def weight(self) -> float:
        """Median length of the specific force [m/s²]: near 9.8 in flight and in the hand."""
        return float(np.median(np.linalg.norm(self.log.accel, axis=1)))

    @cached_property
    def upright(self) -> float:
        """Mean of the specific force along body z, over that length: near 1 in a flight."""
        return float(self.log.accel[:, 2].mean() / max(self.weight, 1e-9))

    @cached_property
    def still(self) -> list[str]:
        """Sensors, or axes of one, that read the same number all the time."""
        found = []
        for name, values in (("the gyroscope", self.log.gyro), ("the accelerometer", self.log.accel)):
            axes = [f"{name}'s {axis}" for axis, own in zip("xyz", values.T, strict=True) if np.ptp(own) == 0]
            found += [name] if len(axes) == 3 else axes
        return found

    @cached_property
    def faults(self) -> list[str]:
        """Why scores on this log would mean nothing, in sentences; none where all is well."""
        return [*self._reading_faults(), *self._rate_faults(), *self._frame_faults()]

    @property
    def warnings(self) -> list[str]:
        """What a user ought to look into, in sentences."""
        damage = [note for note in self.log.notes if note.startswith("damaged: ")]
        return [*self.faults, *damage, *self._sample_warnings(), *self._frame_warnings()]

    def _reading_faults(self) -> Iterator[str]:
        """Constant readings, and a specific force of another length or direction than gravity's."""
        yield from (f"{sensor} reads the same number all the time" for sensor in self.still)
        low, high = CHECK.weights
        if "the accelerometer" not in self.still and not low <= self.weight <= high:
            force = f"the specific force has a median of {self.weight:.4g} m/s²"
            yield f"{force}, and gravity alone is 9.8: {_unit_of('accel', self.weight / 9.81)}"
        elif self.log.truth == "none" and self.upright < CHECK.upright:
            mend = DOWNWARD if self.upright < -CHECK.upright else f"is the frame FLU? {self._mend}"
            carries = f"body z carries {self.upright:.2f} of the specific force"
            yield f"{carries}, and in a flight it carries nearly all: {mend}"

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
            times = f"the gyroscope reads {slope:.3g} times the rate at which the truth turns (slope)"
            yield f"{times}: {_unit_of('gyro', slope, r)}"

    def _frame_faults(self) -> Iterator[str]:
        """A truth that is no attitude, or of other axes than the readings."""
        length = np.linalg.norm(np.ones((0, 4)) if self.log.quat is None else self.log.quat, axis=1)
        length = (
            float(np.median(length[length > 0])) if (length > 0).any() else 1.0
        )  # not NaN; may be infinite
        if abs(length - 1.0) > CHECK.unit_norm:
            yield f"the truth's quaternions have a length of {length:.3g}, not 1"
        found = self.aligned and self.aligned.turned
        if found and found.agreement < CHECK.agreement:
            fault = f"the truth does not turn as the gyroscope does (correlation {found.agreement:.2f})"
            by = f"; with the IMU rotated by {found.rotation_deg:.0f}° it does ({found.rotated:.2f})"
            mounting = f"{by}: {self._mend_of_truth}" if found.rotated > CHECK.mounted_agreement else ""
            yield f"{fault}: look at frame and mount{mounting}"
        elif found and min(found.axes) < CHECK.agreement:
            worst = int(np.argmin(found.axes))
            axis = f"the gyroscope's {'xyz'[worst]} does not read how the truth turns about that axis"
            yield f"{axis} (correlation {found.axes[worst]:.2f}): look at frame and mount"
        yield from self._off_gravity(CHECK.gravity_wrong, np.inf)

    def _off_gravity(self, least: float, most: float) -> Iterator[str]:
        """A mean force in the world that is further from gravity than `least`, and no further than `most`."""
        if self.gravity is None or not least < np.linalg.norm(self.gravity - (0.0, 0.0, 9.81)) <= most:
            return
        x, y, z = self.gravity
        mend = DOWNWARD if z < -2 * abs(x) - 2 * abs(y) else f"look at frame and mount; {self._mend_of_truth}"
        force = f"the specific force averages ({x:.1f}, {y:.1f}, {z:.1f}) m/s², not (0, 0, 9.8)"
        yield f"frames disagree: turned to the world, {force}: {mend}"

    def _sample_warnings(self) -> Iterator[str]:
        """Samples that are missing, left out or doubtful."""
        n, back_s, rate = self.counts, self.counts["clock_back_ms"] / 1e3, self.counts["source_rate_hz"]
        jumps = f"; the clock goes back by {back_s:.1f} s, and the log jumps where it resumes"
        parts = f"gaps of more than {LONGEST_GAP_S:g} s cut this log into {n['parts']} parts"
        longest = f"{n['gap_s']:.2f} s in all, the longest {n['longest_gap_s']:.3f} s"
        if n["parts"] > 1:
            yield f"{parts}: the longest was read"
        if n["stamps_back"]:
            after = jumps if 1e3 * back_s > CHECK.clock_back_ms else ""
            yield f"{n['stamps_back']} samples do not follow the one before in time: left out{after}"
        if n["gaps"]:
            yield f"{n['gaps']} gap{'s' if n['gaps'] > 1 else ''}, {longest}: left out of scores"
        if n["lost"]:
            yield f"{n['lost']} single sample{'s' if n['lost'] > 1 else ''} lost: interpolated"
        yield from (fault.sentence for fault in self.sensor_faults)
        if rate < CHECK.slow_hz:
            yield f"sampled at {rate:.0f} Hz: motion above {0.4 * rate:.0f} Hz is not in this log"
        if n["repeated"]:
            yield f"{n['repeated']} samples repeat the one before"
        if n["missing"]:
            yield f"{n['missing']} samples or stamps are not numbers, or beyond any sensor's range: left out"

    def _frame_warnings(self) -> Iterator[str]:
        """A truth that is missing or late, or an IMU that is mounted in another way."""
        found, rest = self.aligned, self.rest
        if OWN_ESTIMATE in self.log.truth:
            yield f"{self.log.truth}: errors are differences from that estimate"
        if self.log.truth == "none":
            yield UNSCORED
            if rest and rest.seconds >= CHECK.least_rest_s and rest.rate > np.radians(CHECK.large_bias_deg):
                rate = f"{np.degrees(rest.rate):.1f} °/s across the vertical"
                failing = any(fault.sensor == "gyroscope" for fault in self.sensor_faults)
                mend = FAILING if failing else f"`quadsim identify {self.log.path} --still`"
                yield f"at rest for {rest.seconds} s, the gyroscope reads {rate}, a large bias: {mend}"
            shake = fast_part(self.log.accel, self.counts["source_rate_hz"])
            if (vibration := float(np.sqrt((shake**2).sum(axis=1).mean()))) > CHECK.vibration:
                shakes = f"the accelerometer vibrates by {vibration:.1f} m/s² RMS above 20 Hz"
                yield f"{shakes}, and above {CHECK.vibration:g} m/s² its mean may be shifted"
        elif self.counts["truth_share"] == 0.0:
            yield "the true attitude is known at no sample of the IMU: are both on one clock?"
        yield from self._off_gravity(CHECK.gravity_tolerance, CHECK.gravity_wrong)
        if not self.faults:
            turned = found and found.turned
            if turned and turned.gain > CHECK.mounted_gain and turned.common > CHECK.mounted_agreement:
                gyro = f"the gyroscope rotated by {turned.rotation_deg:.0f}°"
                yield f"the truth turns as {gyro} does: {self._mend_of_truth}"
            if self.tilted and self.log.truth_axes == "body":  # a truth of the IMU's axes needs no mount
                yield self.tilted
        late = abs(found.delay_s) > CHECK.delay_tolerance_s if found else False
        if found and late and found.turned.agreement >= CHECK.agreement:
            ms, which = abs(found.delay_s) * 1e3, "late" if found.delay_s > 0 else "early"
            yield f"the truth is {ms:.0f} ms {which}: scores count that as errors of the estimators"

    @property
    def _mend(self) -> str:
        far = self.level is not None and self.level.tilt_deg > CHECK.far_deg
        about = f', about --mount "{mount_text(self.level.mount)}"' if self.level and far else ""
        command = f"`quadsim report {self.log.path} --find-mount best`"
        return f"{command} estimates the --mount that corrects it{about}"

    @property
    def _mend_of_truth(self) -> str:
        """The same where the truth is the body's; a mount rotates one of the IMU with it."""
        return self._mend if self.log.truth_axes == "body" else "is the truth the IMU's (truth_axes)?"

    @property
    def tilted(self) -> str:
        """Of a mean force that is far from body z, how far and what corrects it; else empty."""
        mean = self.level
        if mean is None or mean.tilt_deg <= CHECK.tilt_deg + 2 * mean.sd_deg:
            return ""
        return f"the mean specific force is {mean.tilt_deg:.1f}° from body z: {self._mend}"


def show_report(path: Path, report: LogReport) -> None:
    """Print what a log holds, what is odd about it, and what was taken for the truth."""
    n, low_pass = report.counts, report.filter_hz
    rows = {
        "format": report.log.format,
        "samples": f"{n['samples']} in {n['duration_s']:.2f} s",
        "sample rate": f"{n['source_rate_hz']:.2f} Hz, {n['jitter_ms']:.3f} ms SD from step to step",
        "brought to": f"200 Hz, {f'low-pass at {low_pass:g} Hz' if low_pass else 'nothing to filter'}",
        "gaps": f"{n['gaps']}, {n['gap_s']:.3f} s in all, longest {n['longest_gap_s']:.3f} s",
        "single samples lost": n["lost"],
        "stamps not after the last": n["stamps_back"],
        "repeated samples": n["repeated"],
        "samples not numbers": n["missing"],
        "truth": report.log.truth,
        "truth known": f"{100 * n['truth_share']:.1f} % of the time, at {n['truth_rate_hz']:.1f} Hz",
    }
    if report.gravity is not None:
        x, y, z = report.gravity
        rows["mean force in the world"] = f"({x:.2f}, {y:.2f}, {z:.2f}) m/s²"
    if (found := report.aligned) is not None:
        rows["truth late by"] = f"{1e3 * found.delay_s:.1f} ms, correlation {found.agreement:.3f}"
        rows["gyroscope over truth"] = f"{found.slope:.3f}"
    share = f"{100 * report.upright:.0f} % of it along body z"
    rows["specific force"] = f"median {report.weight:.2f} m/s², {share}"
    print_table([*rows.items(), *(("note", note) for note in report.log.notes)])
    for warning in report.warnings:
        say(f"! {warning}")
    count = len(report.warnings)
    verdict = "nothing odd" if not count else f"{count} {'thing' if count == 1 else 'things'} to know"
    say(f"{path}: {n['duration_s']:.1f} s, {verdict}")


def _unit_of(sensor: str, ratio: float, r: float = 1.0) -> str:
    """The unit that a factor looks like that is uncertain between r and 1/r times itself."""
    for unit, factor in UNITS[sensor].items():
        if abs(np.log(ratio / factor)) < 0.25 - np.log(r):
            return f'is it in {unit} ({sensor}.unit = "{unit}")?'
    return "look at its unit, and at that of the stamps"
