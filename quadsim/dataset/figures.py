"""Pictures of a dataset: the distributions of readings and attitudes, and one flight."""

from collections.abc import Sequence
from pathlib import Path

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
PANELS = (
    ("Gyroscope", "rad/s", "xyz"),
    ("Accelerometer x, y", "m/s²", "xy"),
    ("Accelerometer z", "m/s²", "z"),
    ("Attitude", "deg", ("roll", "pitch")),
)
"""Title, unit and components of each panel."""


def plot(path: str | Path, out_png: str | Path) -> Path:
    """Draw the distributions of gyroscope, accelerometer and attitude (the paper's Fig. 3), and one flight.

    Args:
        path: A dataset.
        out_png: Picture to write; the suffix chooses the format.

    Returns:
        The path of the picture.

    Raises:
        ValueError: `path` is not a dataset or has no valid sample, or the picture format is unknown.
        OSError: The picture cannot be written.
    """
    dataset, out = open_dataset(path), Path(out_png).expanduser()
    rate_hz, valid = dataset.attrs["rate_hz"], dataset["valid_steps"].to_numpy()
    longest, every = int(valid.argmax()), max(1, int(valid.sum()) // SAMPLES)
    shown = min(int(valid[longest]), max(1, round(SHOWN_S * rate_hz)))
    series = _values(dataset.isel(flight=longest, time=slice(shown)))
    each = [_values(dataset.isel(flight=k, time=slice(0, int(end), every))) for k, end in enumerate(valid)]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.4, 9), layout="constrained")
        above, below = figure.add_gridspec(2, 1, height_ratios=(1, 2.4))
        above, below = figure.add_subfigure(above), figure.add_subfigure(below)
        above.suptitle(f"{valid.size} flights of {dataset.attrs['duration_s']:g} s at {rate_hz:g} Hz")
        below.suptitle(f"Flight {longest}, its first {shown / rate_hz:g} s")
        stack = list(below.subplots(4, 1, sharex=True))
        for k, (axes, (title, unit, labels)) in enumerate(zip(above.subplots(1, 4), PANELS, strict=True)):
            _draw_distribution(axes, np.concatenate([values[k] for values in each]), labels)
            axes.set(title=title, xlabel=unit, ylabel="" if k else "density")
            for column, label, (color, dash) in zip(series[k].T, labels, LINES, strict=False):
                stack[k].plot(np.arange(shown) / rate_hz, column, label=label, lw=0.9, c=color, ls=dash)
            stack[k].set(title=title, ylabel=unit, xlim=(0.0, (shown - 1) / rate_hz))
            stack[k].legend(fontsize=8, loc="lower right", bbox_to_anchor=(1, 1), ncols=3, borderaxespad=0)
        stack[-1].set_xlabel("time [s]")
        save_figure(out, figure, dpi=160)
    return out


def _values(flight: xr.Dataset) -> list[Array]:
    """Return the samples of one flight, an array (T, components) for each of `PANELS`."""
    accel = flight["accel"].to_numpy()
    angles = np.degrees(roll_pitch_from_quat(flight["quat"].to_numpy().astype(float)))
    return [flight["gyro"].to_numpy(), accel[:, :2], accel[:, 2:], angles]


def _draw_distribution(axes: Axes, values: Array, labels: Sequence[str]) -> None:
    low, high = np.percentile(values, (0.1, 99.9))
    for column, label, (color, dash) in zip(values.T, labels, LINES, strict=False):
        density, edges = np.histogram(column, BINS, (low, high), density=True)
        name = f"{label}, SD {np.std(column, dtype=float):.2f}"
        axes.step(edges, np.append(density, density[-1]), where="post", label=name, lw=1.1, c=color, ls=dash)
    axes.set_ylim(0, 1.45 * axes.get_ylim()[1])
    axes.legend(fontsize=8, loc="upper right", borderaxespad=0)
