"""What a slow estimator costs the attitude loop: margins, disturbance rejection and steps at each delay.

The linear loop is that of `quadsim.control.gains`, an angular acceleration d added to what the rotors make:

    θ / d = S_rate / s² / (1 + L_att),   S_rate = 1 / (1 + L_rate)

The steps are simulated with rotor limits and sampling, and with the true attitude delayed.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Unpack

import control
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import root_scalar

from quadsim.control.gains import PHASE_MARGIN_DEG, Margins, attitude_loop, blocks, margins, rate_loop
from quadsim.dataset.figures import STYLE
from quadsim.estimator import OtherSensors
from quadsim.flight.loop import FlightLoop
from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.files import save_figure
from quadsim.vehicle import GRAVITY, Gains, Vehicle

Array = NDArray[np.float64]

DELAYS_MS = (0.0, 5.0, 15.0, 30.0, 60.0, 100.0)
"""Delays that are shown: none, one sample at 200 Hz, a network of three steps, and beyond."""
FREQUENCIES = np.geomspace(0.5, 200.0, 300)
"""Where curves are drawn [rad/s]."""
STEP_DEG, STEP_S = 10.0, 1.5
"""Size and length of the steps of roll."""
SETTLED = 0.05
"""Part of a step within which it has settled."""


class Response(NamedTuple):
    """The attitude loop with an estimator of some delay."""

    delay_ms: float
    margins: Margins  #: with the given gains
    sensitivity_db: float  #: largest |1 / (1 + L)|: by how much some disturbances are made worse
    rejection: Array  #: |θ / d| at `FREQUENCIES` [s²]
    step: Array  #: roll in the simulated step, (T,) [deg]
    linear: Array  #: the same of the linear loop, (T,) [deg]
    overshoot: float  #: of the simulated step, as a share of it; infinite if it grows
    settling_s: float  #: when it stays within `SETTLED`; infinite if it does not
    redesigned: float  #: crossover if the gain were chosen for this delay [rad/s]

    @property
    def affordable(self) -> str:
        """A word for it, by the usual rules: 45° and 6 dB for comfort, none left for the end."""
        if self.margins.phase_deg <= 0 or self.margins.gain_db <= 0:
            return "unstable"
        return "yes" if self.margins.phase_deg >= 45 and self.margins.gain_db >= 6 else "barely"


class DelayedTruth:
    """The true attitude of some samples ago: an estimator with a delay and no other error."""

    def __init__(self, samples: int, rate_hz: float) -> None:
        self.rate_hz, self._samples = rate_hz, samples
        self._line: list[Array] = []

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Start n vehicles."""
        self._line = []

    def observe(self, quat: Array) -> None:
        """Take the truth."""
        now = roll_pitch_from_quat(quat)
        self._line = [*(self._line or [now] * self._samples), now]

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Give what was true."""
        return self._line.pop(0)


def responses(
    vehicle: Vehicle, gains: Gains, rate_hz: float = 200.0, delays_ms: Sequence[float] = DELAYS_MS
) -> list[Response]:
    """The attitude loop with the same gains at each delay of the estimator [ms], rounded to whole samples."""
    return [_response(vehicle, gains, rate_hz, round(ms * rate_hz / 1e3)) for ms in delays_ms]


def fly_step(vehicle: Vehicle, gains: Gains, rate_hz: float, samples: int) -> Array:
    """Roll (T,) [deg] after the command steps from 0 to `STEP_DEG`, with the truth of `samples` ago."""
    vehicle = vehicle.model_copy(update={"controller": gains})
    loop = FlightLoop(vehicle, rate_hz=rate_hz, estimator=DelayedTruth(samples, rate_hz))
    loop.reset(position=[[0.0, 0.0, 20.0]])
    command = np.array([[np.radians(STEP_DEG), 0.0, 0.0, GRAVITY]])
    roll = np.zeros(round(STEP_S * rate_hz) + 1)
    for k in range(1, roll.size):
        loop.step("attitude", command)
        roll[k] = np.degrees(loop.true_attitude[0, 0])
    return roll


def draw(found: Sequence[Response], rate_hz: float = 200.0, title: str = "") -> Figure:
    """Margins, disturbance rejection and steps against the delay."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.4, 5.6), layout="constrained")
        figure.suptitle(title, x=0.01, ha="left")
        panels = figure.subplots(2, 2)
        colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, len(found)))
        _draw_margins(panels[0, 0], found)
        _draw_rejection(panels[0, 1], found, colours)
        time = np.arange(found[0].step.size) / rate_hz
        for each, colour in zip(found, colours, strict=True):
            label = f"{each.delay_ms:g} ms"
            panels[1, 0].plot(time, each.linear, color=colour, label=label)
            panels[1, 1].plot(time, each.step, color=colour, label=label)
        for axes, name in (
            (panels[1, 0], "Step of roll, linear loop"),
            (panels[1, 1], "The same, simulated"),
        ):
            axes.axhline(STEP_DEG, color="#999999", lw=0.8, ls=":")
            axes.set(title=name, xlabel="time [s]", ylabel="roll [°]", ylim=(-1, 20), xlim=(0, STEP_S))
        panels[1, 1].legend(title="delay of the estimator", ncols=2, fontsize=8, title_fontsize=8)
        return figure


def save(found: Sequence[Response], path: str | Path, rate_hz: float = 200.0, title: str = "") -> Path:
    """`draw`, as a file; its ending chooses the format."""
    return save_figure(Path(path).expanduser(), draw(found, rate_hz, title), dpi=130)


def table(found: Sequence[Response]) -> list[dict[str, str]]:
    """The numbers of each delay as text, by their headings."""
    return [
        {
            "delay, ms": f"{r.delay_ms:g}",
            "phase, °": f"{r.margins.phase_deg:.0f}",
            "gain, dB": f"{r.margins.gain_db:.1f}",
            "spare, ms": f"{r.margins.delay_ms:.0f}",
            "peak S, dB": f"{r.sensitivity_db:.1f}",
            "overshoot, %": f"{100 * max(r.overshoot, 0.0):.0f}",
            "settled, s": f"{r.settling_s:.2f}" if np.isfinite(r.settling_s) else f"> {STEP_S:g}",
            "redesigned, rad/s": f"{r.redesigned:.1f}",
            "affordable": r.affordable,
        }
        for r in found
    ]


def _response(vehicle: Vehicle, gains: Gains, rate_hz: float, samples: int) -> Response:
    delay = samples / rate_hz
    b = blocks(vehicle, rate_hz, delay)
    inner, outer = rate_loop(b, gains.rate), attitude_loop(b, gains.rate, gains.attitude)
    sensitivity = control.feedback(1, outer)
    rejection = control.feedback(1, inner) * b.integrator * b.integrator * sensitivity
    forward = attitude_loop(b, gains.rate, gains.attitude, delayed=False)
    time = np.arange(round(STEP_S * rate_hz) + 1) / rate_hz
    linear = control.step_response(control.feedback(forward, b.estimator), time).outputs
    step = fly_step(vehicle, gains, rate_hz, samples)
    unsettled = np.flatnonzero(np.abs(step / STEP_DEG - 1) > SETTLED)
    settled = int(unsettled[-1]) + 1 if unsettled.size else 0
    gain = root_scalar(
        lambda k: margins(attitude_loop(b, gains.rate, k)).phase_deg - PHASE_MARGIN_DEG["attitude"],
        bracket=(0.1 * gains.attitude, 2.0 * gains.attitude),
        xtol=1e-6,
    ).root
    return Response(
        1e3 * delay,
        margins(outer),
        float(20 * np.log10(_size(sensitivity, FREQUENCIES).max())),
        _size(rejection, FREQUENCIES),
        step,
        STEP_DEG * np.asarray(linear, dtype=np.float64),
        float(step.max() / STEP_DEG - 1),
        settled / rate_hz if settled < step.size else np.inf,
        margins(attitude_loop(b, gains.rate, gain)).crossover,
    )


def _size(system: control.TransferFunction, omega: Array) -> Array:
    return np.abs(np.asarray(system(1j * omega)))


def _draw_margins(axes: Axes, found: Sequence[Response]) -> None:
    delay, sensitivity = [each.delay_ms for each in found], [each.sensitivity_db for each in found]
    phase, spare = zip(*((each.margins.phase_deg, each.margins.delay_ms) for each in found), strict=True)
    lines = axes.plot(delay, phase, "o-", color="#0072b2", label="phase margin [°]")
    lines += axes.plot(delay, spare, "s--", color="#e08a00", label="spare delay [ms]")
    axes.axhline(45, color="#999999", lw=0.8, ls=":")
    title, label = "Margins of the attitude loop", "delay of the estimator [ms]"
    axes.set(title=title, xlabel=label, ylim=(0, 1.5 * max(spare)))
    twin = axes.twinx()
    lines += twin.plot(delay, sensitivity, "^-.", color="#111111", label="peak of |S| [dB]")
    twin.set(ylabel="peak of |S| [dB]", ylim=(0, 1.5 * max(sensitivity)))
    twin.grid(visible=False)
    axes.legend(lines, [str(line.get_label()) for line in lines], fontsize=8, ncols=2, loc="upper center")


def _draw_rejection(axes: Axes, found: Sequence[Response], colours: Array) -> None:
    for each, colour in zip(found, colours, strict=True):
        axes.loglog(FREQUENCIES, np.degrees(each.rejection), color=colour, label=f"{each.delay_ms:g} ms")
    axes.set(
        title="What a disturbance leaves of itself",
        xlabel="frequency [rad/s]",
        ylabel="tilt per angular acceleration [° s²/rad]",
    )
