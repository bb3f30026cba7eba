"""Poses, traces and spikes of a flight over time, and their files for viewers."""

import errno
import importlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..rotation import quat_from_euler
from ..runs.files import alone, replace
from ..vehicle import Vehicle

Array = NDArray[np.float64]

BODY = "body"
"""Name of the true pose."""
COLOURS = {"true": (237, 92, 23), "target": (25, 190, 76), "wind": (150, 110, 240)}
PALETTE = (25, 140, 242), (240, 190, 40), (90, 200, 120), (220, 110, 190), (110, 210, 220), (170, 170, 170)
"""Colours of estimators and of other curves, in order."""


class Trace(NamedTuple):
    """Curves in one plot."""

    unit: str
    curves: Mapping[str, Array]
    """Curves by label, (T,) each; NaN where there is no value."""


class SpikeRaster(NamedTuple):
    """Spikes of a population of neurons, in order of time."""

    time: Array
    """Times of the spikes (K,) [s]."""
    neuron: NDArray[np.int64]
    """Index of the neuron of each spike (K,)."""


@dataclass(frozen=True)
class Timeline:
    """A flight as viewers show it; unknown values are NaN."""

    time: Array
    """Times of the samples (T,) [s]."""
    vehicle: Vehicle
    """Vehicle whose outline is drawn."""
    position: Array
    """Position of every pose in world axes (T, 3) [m]."""
    poses: Mapping[str, Array]
    """quat_WB (T, 4) by name: the true one, if known, as `BODY`, and that of every estimator."""
    gyro: Array
    """Readings of the gyroscope (T, 3) [rad/s]."""
    accel: Array
    """Readings of the accelerometer (T, 3) [m/s²]."""
    traces: Mapping[str, Trace]
    target: Array | None = None
    """Set-point in the world (T, 3) [m]."""
    wind: Array | None = None
    """Wind in world axes (T, 3) [m/s]."""
    spikes: Mapping[str, SpikeRaster] = field(default_factory=dict)
    """Spikes of spiking networks by population; no population is empty."""


def attitudes(
    euler: Array, estimates: Mapping[str, Array], sigmas: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, Trace]]:
    """Make poses and traces of roll and pitch, for the truth and for estimators.

    Args:
        euler: True roll, pitch and yaw (T, 3) [rad]; NaN where not known.
        estimates: Estimated roll and pitch (T, 2) [rad]. The poses use the true yaw, or zero yaw if it is
            unknown.
        sigmas: Standard deviations of roll and pitch (T, 2) [rad], for estimators that provide them.

    Returns:
        The poses; the traces "roll" and "pitch"; and, if the truth is known, "error of roll" and "error of
        pitch".
    """
    roll, pitch, yaw = euler.T
    poses = {BODY: quat_from_euler(roll, pitch, yaw)} if np.isfinite(euler).all(axis=1).any() else {}
    for name, estimate in estimates.items():
        poses[name] = quat_from_euler(estimate[:, 0], estimate[:, 1], np.nan_to_num(yaw))
    traces = {}
    for k, angle in enumerate(("roll", "pitch")):
        curves, errors = {"true": euler[:, k]}, {}
        for name, estimate in estimates.items():
            curves[name] = estimate[:, k]
            errors[name] = np.remainder(estimate[:, k] - euler[:, k] + np.pi, 2 * np.pi) - np.pi
            for sign, bound in ((1, "plus sigma"), (-1, "minus sigma")) if name in sigmas else ():
                curves[f"{name} {bound}"] = estimate[:, k] + sign * sigmas[name][:, k]
                errors[f"{name} {bound}"] = sign * sigmas[name][:, k]
        traces[angle] = Trace("deg", {label: np.degrees(each) for label, each in curves.items()})
        if BODY in poses:
            traces[f"error of {angle}"] = Trace(
                "deg", {label: np.degrees(each) for label, each in errors.items()}
            )
    return poses, traces


def styles(labels: Iterable[str], poses: Iterable[str]) -> list[tuple[tuple[int, int, int], bool]]:
    """Return colours of poses or curves by label, and which curves accompany another curve.

    A curve accompanies another one if its label continues that label after a space, and then has the same
    colour: "imm plus sigma" accompanies "imm".

    Args:
        labels: Labels of a trace, or of poses.
        poses: Names of the poses of a timeline.
    """
    labels, estimators = list(labels), [name for name in poses if name != BODY]
    curves = [next((each for each in labels if label.startswith(f"{each} ")), label) for label in labels]
    others = [each for each in dict.fromkeys(curves) if each not in ("true", BODY)]
    order = estimators if set(others) <= set(estimators) else others
    colours = {name: PALETTE[k % len(PALETTE)] for k, name in enumerate(order)}
    return [(colours.get(of, COLOURS["true"]), of != label) for of, label in zip(curves, labels, strict=True)]


def axes_of(unit: str, vectors: Array) -> Trace:
    """Return the trace of a vector (T, 3)."""
    return Trace(unit, dict(zip("xyz", vectors.T, strict=True)))


def outline(vehicle: Vehicle, points: int = 25) -> list[Array]:
    """Return polylines in body axes that draw a vehicle's arms, nose and propellers [m]."""
    turn = np.linspace(0.0, 2 * np.pi, points)
    circle = vehicle.frame.prop_radius * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    nose = np.array([[0.0, 0.0, 0.0], [np.linalg.norm(vehicle.hubs, axis=1).max(), 0.0, 0.0]])
    arms = [np.stack([np.zeros(3), hub]) for hub in vehicle.hubs]
    return [nose, *arms, *(hub + circle for hub in vehicle.hubs)]


@contextmanager
def viewer_files(rerun: Path | None, mcap: Path | None) -> Iterator[Callable[[Timeline], None] | None]:
    """Check that files for viewers can be written, and return a function that writes them.

    Args:
        rerun: File for rerun, .rrd.
        mcap: File for Foxglove, .mcap.

    Returns:
        The function; None if no file is given.

    Raises:
        ValueError: A file has the wrong suffix, or another process is writing it.
        OSError: A file cannot be written.
        ModuleNotFoundError: The package that writes a file is not installed.
    """
    wanted = {".rrd": (rerun, "rerun", "rerun"), ".mcap": (mcap, "mcap.writer", "mcap")}
    files = {}
    with ExitStack() as stack:
        for suffix, (path, package, kind) in wanted.items():
            if path is None:
                continue
            if path.suffix != suffix:
                raise ValueError(f"{path}: should end in {suffix}")
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
            importlib.import_module(package)
            module = importlib.import_module(f".{kind}_file", __package__)
            files[path] = getattr(module, f"write_{kind}")
            stack.enter_context(alone(path))

        def write(timeline: Timeline) -> None:
            for path, to in files.items():
                replace(path.expanduser(), partial(to, timeline=timeline))

        yield write if files else None
