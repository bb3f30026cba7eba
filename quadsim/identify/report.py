"""What identification found, as a vehicle file and as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tomli_w
from matplotlib.figure import Figure

from ..runs.files import write_whole
from ..vehicle import Vehicle
from .fit import Identified
from .noise import InFlight

SHOWN_S = 10.0
"""Length of the part that is drawn [s]."""
ROWS = ("force x", "force y", "force z", "ang. acc. x", "ang. acc. y", "ang. acc. z")
AXES = ("x", "y", "z")


def write_vehicle(found: Identified, out: str | Path, logs: Sequence[str]) -> Vehicle:
    """Write a vehicle file with the constants that were identified, and what is not from these flights.

    Returns:
        The vehicle as it was written.

    Raises:
        ValueError: The constants are of no vehicle that can fly.
    """
    name = Path(out).stem
    lines = [
        f"# By `quadsim identify` from {', '.join(logs)}. Mass, hubs and outline are those it began with."
    ]
    lines += [
        f"# {each.path}: {each.fitted:.4g} ± {each.half_width:.2g} {each.unit}" for each in found.constants
    ]
    lines += [f"# Not identified: {line}" for line in found.missing]
    content = found.vehicle.model_dump(mode="json", exclude_none=True)
    content |= {"name": name, "source": f"quadsim identify, from {found.vehicle.name}"}
    vehicle = Vehicle.model_validate(content)
    write_whole(out, "\n".join(lines) + "\n\n" + tomli_w.dumps(content))
    return vehicle


def draw_fit(found: Identified) -> Figure:
    """Measured and modelled force and angular acceleration, the busiest seconds of the first flight."""
    measured, modelled = found.measured[0], found.modelled[0]
    steps = min(round(SHOWN_S * found.rate_hz), len(measured))
    busy = np.convolve((measured[:, 3:] ** 2).sum(axis=1), np.ones(steps), "valid")
    part = slice(int(busy.argmax()), int(busy.argmax()) + steps)
    time = np.arange(steps) / found.rate_hz
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True)
    for k, (row, explained) in enumerate(zip(ROWS, found.explained, strict=True)):
        ax = axes[k % 3, k // 3]
        ax.plot(time, measured[part, k], color="0.55", lw=2.2, label="measured")
        ax.plot(time, modelled[part, k], color="#b3390e", lw=1.0, label="model")
        ax.set_title(f"{row}: {explained:.1%} of the variance", loc="left", fontsize=10)
        ax.set_ylabel("m/s²" if k < 3 else "rad/s²")
        ax.grid(alpha=0.3)
    axes[0, 0].legend(loc="upper right", ncols=2, fontsize=9)
    for ax in axes[-1]:
        ax.set_xlabel("time, s")
    return figure


def draw_noise(gyro: InFlight, accel: InFlight, at_rest: tuple[InFlight, InFlight] | None = None) -> Figure:
    """Densities of the readings in flight, and at rest where the log has rest, as IMU files give them."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for k, (ax, each, unit) in enumerate(
        zip(figure.subplots(1, 2), (gyro, accel), ("rad/s", "m/s²"), strict=True)
    ):
        for axis, colour in zip(range(3), ("#0072b2", "#d55e00", "#009e73"), strict=True):
            density = np.sqrt(0.5 * each.density[1:, axis])
            ax.loglog(each.frequency[1:], density, color=colour, lw=1.2, label=f"{AXES[axis]}, in flight")
        if at_rest is not None:
            rest = at_rest[k]
            mean = np.sqrt(0.5 * rest.density[1:].mean(axis=1))
            ax.loglog(
                rest.frequency[1:], mean, color="0.4", lw=1.2, ls="--", label="at rest, mean of the axes"
            )
        if np.isfinite(each.line_hz):
            ax.axvline(each.line_hz, color="0.3", lw=0.8, ls=":")
            ax.annotate(
                f"{each.line_hz:.0f} Hz", (each.line_hz, 0.02), xycoords=("data", "axes fraction"), ha="right"
            )
        ax.set_title(("gyroscope", "accelerometer")[k], loc="left", fontsize=10)
        ax.set_xlabel("frequency, Hz")
        ax.set_ylabel(f"{unit}/√Hz")
        ax.grid(alpha=0.3, which="both")
    figure.axes[0].legend(loc="lower left", fontsize=9)
    return figure
