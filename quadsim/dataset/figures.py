"""Pictures of a dataset: how its sensors and attitudes are distributed, and what one flight looks like."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import RcKeyType
from numpy.typing import NDArray

from ..rotation import roll_pitch_from_quat
from ..runs.files import save_figure
from .reading import open_dataset

Array = NDArray[np.float64]

LINES = (("#111111", "-"), ("#0072b2", "--"), ("#e08a00", "-."))  # distinct in grey too
STYLE: dict[RcKeyType, object] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.handlelength": 2.4,
}
BINS = 120
SAMPLES = 1_000_000  # a distribution is drawn from about this many at most
SHOWN_S = 15.0  # of the sample flight


class Quantity(NamedTuple):
    """Something with two or three components, for one panel."""

    title: str
    unit: str
    labels: Sequence[str]
    values: Array
    """(samples, components)."""


def plot(path: str | Path, out_png: str | Path) -> Path:
    """Draw the distributions of gyroscope, accelerometer and attitude (the paper's Fig. 3), and one flight.

    Args:
        path: A dataset.
        out_png: Where to write the picture; its ending chooses the format.

    Returns:
        The path of the picture.

    Raises:
        ValueError: Not a dataset, nothing in it, or no such picture format.
        OSError: The picture cannot be written.
    """
    dataset, out = open_dataset(path), Path(out_png).expanduser()
    flights, rate_hz = dataset.sizes["flight"], dataset.attrs["rate_hz"]
    every = max(1, int(dataset["valid_steps"].sum()) // SAMPLES)
    longest = int(np.argmax(dataset["valid_steps"].to_numpy()))
    shown = _valid_samples(dataset, longest).isel(time=slice(max(1, round(SHOWN_S * rate_hz))))
    if shown.sizes["time"] == 0:
        raise ValueError(f"{path}: every flight ended before its first sample; there is nothing to draw")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.4, 9), layout="constrained")
        above, below = figure.add_gridspec(2, 1, height_ratios=(1, 2.4))
        above, below = figure.add_subfigure(above), figure.add_subfigure(below)
        above.suptitle(f"{flights} flights of {dataset.attrs['duration_s']:g} s at {rate_hz:g} Hz")
        below.suptitle(f"Flight {longest}, its first {shown.sizes['time'] / rate_hz:g} s")
        for axes, quantity in zip(above.subplots(1, 4), _all_samples(dataset, every), strict=True):
            _draw_distribution(axes, quantity)
        stack = list(below.subplots(4, 1, sharex=True))
        for axes, quantity in zip(stack, _quantities(shown), strict=True):
            _draw_series(axes, shown["time"].to_numpy(), quantity)
        stack[-1].set_xlabel("time [s]")
        save_figure(out, figure, dpi=160)
    return out


def _quantities(flight: xr.Dataset) -> list[Quantity]:
    """What is drawn of some samples of one flight."""
    gyro, accel = flight["gyro"].to_numpy(), flight["accel"].to_numpy()
    angles = np.degrees(roll_pitch_from_quat(flight["quat"].to_numpy().astype(float)))
    return [
        Quantity("Gyroscope", "rad/s", "xyz", gyro),
        Quantity("Accelerometer x, y", "m/s²", "xy", accel[:, :2]),
        Quantity("Accelerometer z", "m/s²", "z", accel[:, 2:]),
        Quantity("Attitude", "deg", ("roll", "pitch"), angles),
    ]


def _valid_samples(dataset: xr.Dataset, flight: int) -> xr.Dataset:
    one = dataset.isel(flight=flight)
    return one.isel(time=slice(int(one["valid_steps"])))


def _all_samples(dataset: xr.Dataset, every: int) -> list[Quantity]:
    """The same of all flights, decimated."""
    flights = [
        _quantities(_valid_samples(dataset, flight).isel(time=slice(None, None, every)))
        for flight in range(dataset.sizes["flight"])
    ]
    return [
        parts[0]._replace(values=np.concatenate([part.values for part in parts]))
        for parts in zip(*flights, strict=True)
    ]


def _draw_distribution(axes: Axes, quantity: Quantity) -> None:
    low, high = np.percentile(quantity.values, (0.1, 99.9))
    for column, label, (color, dash) in zip(quantity.values.T, quantity.labels, LINES, strict=False):
        density, edges = np.histogram(column, BINS, (low, high), density=True)
        name = f"{label}, SD {np.std(column, dtype=float):.2f}"
        axes.step(edges, np.append(density, density[-1]), where="post", label=name, lw=1.1, c=color, ls=dash)
    axes.set(title=quantity.title, xlabel=quantity.unit, ylim=(0, 1.45 * axes.get_ylim()[1]))
    axes.set_ylabel("density" if quantity.title == "Gyroscope" else "")
    axes.legend(fontsize=8, loc="upper right", borderaxespad=0)


def _draw_series(axes: Axes, time: Array, quantity: Quantity) -> None:
    for column, label, (color, dash) in zip(quantity.values.T, quantity.labels, LINES, strict=False):
        axes.plot(time, column, label=label, lw=0.9, c=color, ls=dash)
    axes.set(title=quantity.title, ylabel=quantity.unit, xlim=(time[0], time[-1]))
    axes.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1, 1), ncols=3, borderaxespad=0)
