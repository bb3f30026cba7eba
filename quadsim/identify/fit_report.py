"""The result of an identification as a vehicle file, a picture and tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tomli_w
from matplotlib.figure import Figure

from ..dataset.reading import open_dataset
from ..logs import read_log
from ..runs.console import print_table, say
from ..runs.files import save_figure, write_whole
from ..vehicle import Vehicle, load_vehicle
from .fit import NO_FLIGHT, Identified, identify
from .signals import signals_of

SHOWN_S = 10.0
"""Duration of the part that is drawn [s]."""
ROWS = ("force x", "force y", "force z", "ang. acc. x", "ang. acc. y", "ang. acc. z")


def identify_files(files: Sequence[Path], vehicle: str, out: Path, rate_hz: float, mount: str | None) -> None:
    """Fit a vehicle to files of flights, write the vehicle and a picture, and print the result.

    Raises:
        ValueError: `out` is not a vehicle file, or no flight has the speeds of all rotors of the vehicle.
    """
    start = load_vehicle(vehicle)
    if out.suffix != ".toml":
        raise ValueError(f"{out}: a vehicle file ends in .toml")
    flights = []
    for file in files:
        data = open_dataset(file) if file.suffix == ".zarr" else read_log(file, rate_hz, mount=mount)
        turning = [flight for flight in signals_of(data) if flight.has_rotors]
        if not turning:
            say(f"{file}: {NO_FLIGHT}, left out", "yellow")
        flights += turning
    found = identify(flights, start)
    rows = []
    for path, each in found.constants.to_dict("index").items():
        half, fitted, used = each["half_width"], each["fitted"], each["identified"]
        width = f"{100 * half / fitted:.1f} %" if used else f"{half:.2g}"
        rows.append(
            (path, each["unit"], f"{each['start']:.4g}", f"{fitted:.4g}", width, "yes" if used else "no")
        )
    print_table(rows, ("constant", "unit", "start", "fitted", "± (95 %)", "used"))
    for line in found.missing:
        say(f"not identified: {line}", "yellow")
    write_vehicle(found, out, [str(file) for file in files])
    picture = save_figure(out.with_suffix(".png"), draw_fit(found), dpi=120)
    low = found.explained.min()
    say(
        f"{out}: for --vehicle {out}; the model explains {100 * low:.1f} % or more of each signal ({picture})"
    )


def write_vehicle(found: Identified, out: str | Path, logs: Sequence[str]) -> Vehicle:
    """Write a vehicle file with the identified constants and the initial values of the others.

    Returns:
        The vehicle in the file.

    Raises:
        ValueError: A vehicle with these constants cannot fly.
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
    """Draw measured and modelled force and angular acceleration in an agile part of the first flight."""
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
        ax.set_title(f"{row}: {100 * explained:.1f} % of the variance", loc="left", fontsize=10)
        ax.set_ylabel("m/s²" if k < 3 else "rad/s²")
        ax.grid(alpha=0.3)
    axes[0, 0].legend(loc="upper right", ncols=2, fontsize=9)
    for ax in axes[-1]:
        ax.set_xlabel("time, s")
    return figure
