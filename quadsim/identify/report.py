"""What identification found, as a vehicle file, as pictures and as the tables of `quadsim identify`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tomli_w
from matplotlib.figure import Figure

from ..runs.console import print_table, say
from ..runs.files import save_figure, write_whole
from ..vehicle import Vehicle, load_vehicle
from .fit import Identified, identify
from .noise import Spectrum, spectra_at_rest, spectra_in_flight
from .signals import Flight, read_flights

SHOWN_S = 10.0
"""Length of the part that is drawn [s]."""
ROWS = ("force x", "force y", "force z", "ang. acc. x", "ang. acc. y", "ang. acc. z")
SENSORS = (("gyroscope", "rad/s"), ("accelerometer", "m/s²"))


def identify_files(files: Sequence[Path], vehicle: str, out: Path, rate_hz: float, mount: str | None) -> None:
    """Fit a vehicle to files of flights, write it with its pictures, and print it: `quadsim identify`.

    Args:
        files: Datasets, or logs.
        vehicle: To begin with.
        out: Vehicle file to write; pictures get its name.
        rate_hz: Samples per second that logs are read at.
        mount: Rotation from IMU to body axes of logs.

    Raises:
        ValueError: `out` is no vehicle file, a file has no flight, or the flights do not fit the vehicle.
    """
    start = load_vehicle(vehicle)
    if out.suffix != ".toml":
        raise ValueError(f"{out}: a vehicle file ends in .toml")
    flights = {file: read_flights(file, rate_hz, mount) for file in files}
    show_noise([flight for each in flights.values() for flight in each], out)
    turning = {file: [flight for flight in each if flight.has_rotors] for file, each in flights.items()}
    if not any(turning.values()):
        say(f"no rotor speeds in rad/s: noise and vibration alone, and no {out}", "yellow")
        return
    for file in files:
        if not turning[file]:
            say(f"{file}: no rotor speeds in rad/s, left out", "yellow")
    found = identify([flight for each in turning.values() for flight in each], start)
    rows = []
    for path, each in found.constants.to_dict("index").items():
        half, fitted, used = each["half_width"], each["fitted"], each["identified"]
        width = f"{half / fitted:.1%}" if used else f"{half:.2g}"
        rows.append(
            (path, each["unit"], f"{each['start']:.4g}", f"{fitted:.4g}", width, "yes" if used else "no")
        )
    print_table(rows, ("constant", "unit", "start", "fitted", "± (95 %)", "used"))
    for line in found.missing:
        say(f"not identified: {line}", "yellow")
    write_vehicle(found, out, [str(file) for file in files])
    picture = save_figure(out.with_suffix(".png"), draw_fit(found), dpi=120)
    low = found.explained.min()
    say(f"{out}: for --vehicle {out}; the model explains {low:.1%} or more of each signal ({picture})")


def show_noise(flights: Sequence[Flight], out: Path) -> None:
    """Table and picture of noise and vibration of the longest flight."""
    longest = max(flights, key=lambda flight: len(flight.gyro))
    flying, resting = spectra_in_flight(longest), spectra_at_rest(longest)
    rows = []
    for k, (name, unit) in enumerate(SENSORS):
        found, rest = flying[k], resting and resting[k]
        rows.append((f"{name}, RMS above 25 Hz", unit, found.shaking))
        rows.append((f"{name}, density at 25 to 60 Hz", f"{unit}/√Hz", found.noise))
        if rest:
            rows.append((f"{name}, noise at rest", f"{unit}/√Hz", rest.noise))
        if np.isfinite(found.line_hz):
            rows.append((f"{name}, line at {found.line_hz:.0f} Hz", unit, found.line))
    cells = [(name, unit, *(f"{value:.3g}" for value in values)) for name, unit, values in rows]
    print_table(cells, ("in flight", "unit", "x", "y", "z"))
    picture = save_figure(out.with_name(f"{out.stem}-noise.png"), draw_noise(flying, resting), dpi=120)
    say(f"{picture}: spectra of the readings")


def write_vehicle(found: Identified, out: str | Path, logs: Sequence[str]) -> Vehicle:
    """Write a vehicle file with the constants that were identified, and what is not from these flights.

    Returns:
        The vehicle as it was written.

    Raises:
        ValueError: The constants are of no vehicle that can fly.
    """
    lines = [f"By `quadsim identify` from {', '.join(logs)}. Mass, hubs and outline are those it began with."]
    lines += [
        f"{path}: {each['fitted']:.4g} ± {each['half_width']:.2g} {each['unit']}"
        for path, each in found.constants.to_dict("index").items()
    ]
    lines += [f"Not identified: {line}" for line in found.missing]
    content = found.vehicle.model_dump(mode="json", exclude_none=True)
    content |= {"name": Path(out).stem, "source": f"quadsim identify, from {found.vehicle.name}"}
    vehicle = Vehicle.model_validate(content)
    write_whole(out, "".join(f"# {line}\n" for line in lines) + "\n" + tomli_w.dumps(content))
    return vehicle


def draw_fit(found: Identified) -> Figure:
    """Measured and modelled force and angular acceleration, the busiest seconds of the first flight."""
    measured, modelled = found.measured[0], found.modelled[0]
    steps = min(round(SHOWN_S * found.rate_hz), len(measured))
    first = int(np.convolve((measured[:, 3:] ** 2).sum(axis=1), np.ones(steps), "valid").argmax())
    time = np.arange(steps) / found.rate_hz
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True)
    for k, (row, explained) in enumerate(zip(ROWS, found.explained, strict=True)):
        ax = axes[k % 3, k // 3]
        ax.plot(time, measured[first : first + steps, k], color="0.55", lw=2.2, label="measured")
        ax.plot(time, modelled[first : first + steps, k], color="#b3390e", lw=1.0, label="model")
        ax.set_title(f"{row}: {explained:.1%} of the variance", loc="left", fontsize=10)
        ax.set_ylabel("m/s²" if k < 3 else "rad/s²")
        ax.grid(alpha=0.3)
    axes[0, 0].legend(loc="upper right", ncols=2, fontsize=9)
    for ax in axes[-1]:
        ax.set_xlabel("time, s")
    return figure


def draw_noise(flying: tuple[Spectrum, Spectrum], resting: tuple[Spectrum, Spectrum] | None = None) -> Figure:
    """Densities of the readings in flight, and at rest where the log has rest, as IMU files give them."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for k, (ax, (name, unit)) in enumerate(zip(figure.subplots(1, 2), SENSORS, strict=True)):
        found = flying[k]
        for axis, colour in enumerate(("#0072b2", "#d55e00", "#009e73")):
            density = np.sqrt(0.5 * found.density[1:, axis])
            ax.loglog(found.frequency[1:], density, color=colour, lw=1.2, label=f"{'xyz'[axis]}, in flight")
        if resting is not None:
            mean = np.sqrt(0.5 * resting[k].density[1:].mean(axis=1))
            label = "at rest, mean of the axes"
            ax.loglog(resting[k].frequency[1:], mean, color="0.4", lw=1.2, ls="--", label=label)
        if np.isfinite(found.line_hz):
            ax.axvline(found.line_hz, color="0.3", lw=0.8, ls=":")
            place = {"xy": (found.line_hz, 0.02), "xycoords": ("data", "axes fraction"), "ha": "right"}
            ax.annotate(f"{found.line_hz:.0f} Hz", **place)
        ax.set_title(name, loc="left", fontsize=10)
        ax.set(xlabel="frequency, Hz", ylabel=f"{unit}/√Hz")
        ax.grid(alpha=0.3, which="both")
    figure.axes[0].legend(loc="lower left", fontsize=9)
    return figure
