"""What viewers show of a flight: poses, traces and spikes in time, and the files that hold them."""

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
"""Colours of estimators, and of curves that are not of one, by their order."""


class Trace(NamedTuple):
    """Curves in one plot."""

    unit: str
    curves: Mapping[str, Array]
    """By their labels, (T,); NaN where there is no value."""


class Spikes(NamedTuple):
    """Spikes of a population of neurons, in the order of time."""

    time: Array
    """(K,) [s]."""
    neuron: NDArray[np.int64]
    """Which neuron, counted from 0, (K,)."""


@dataclass(frozen=True)
class Timeline:
    """A flight as viewers show it; NaN where something is not known."""

    time: Array
    """(T,) [s]."""
    vehicle: Vehicle
    """Whose outline is drawn."""
    position: Array
    """In the world, of every pose (T, 3) [m]."""
    poses: Mapping[str, Array]
    """quat_WB (T, 4) of the body, if it is known, under the name `BODY`, and by every estimator."""
    gyro: Array
    """Readings of the gyroscope (T, 3) [rad/s]."""
    accel: Array
    """Readings of the accelerometer (T, 3) [m/s²]."""
    traces: Mapping[str, Trace]
    target: Array | None = None
    """Set-point in the world (T, 3) [m]."""
    wind: Array | None = None
    """In the world (T, 3) [m/s]."""
    spikes: Mapping[str, Spikes] = field(default_factory=dict)
    """Of spiking networks, by population; none is empty."""


def attitudes(
    euler: Array, estimates: Mapping[str, Array], sigmas: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, Trace]]:
    """Poses, and traces of roll and pitch, of the truth and of estimators.

    Args:
        euler: True roll, pitch and yaw (T, 3) [rad]; NaN where not known.
        estimates: Estimated roll and pitch (T, 2) [rad]; drawn with the true yaw, or else with none.
        sigmas: Their standard deviations (T, 2) [rad], of estimators that give one.

    Returns:
        The poses; the traces "roll" and "pitch", and "error of roll" and "error of pitch" where the truth is
        known.
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
    """Colours of poses or of curves by their labels, and which of them are beside another curve.

    Such a one has that curve's label, a space and more, and its colour: "imm plus sigma" is beside "imm".

    Args:
        labels: Of a trace, or of poses.
        poses: Names of the poses of a timeline.
    """
    labels, estimators = list(labels), [name for name in poses if name != BODY]
    curves = [next((each for each in labels if label.startswith(f"{each} ")), label) for label in labels]
    others = [each for each in dict.fromkeys(curves) if each not in ("true", BODY)]
    order = estimators if set(others) <= set(estimators) else others
    colours = {name: PALETTE[k % len(PALETTE)] for k, name in enumerate(order)}
    return [(colours.get(of, COLOURS["true"]), of != label) for of, label in zip(curves, labels, strict=True)]


def axes_of(unit: str, vectors: Array) -> Trace:
    """The trace of a vector (T, 3)."""
    return Trace(unit, dict(zip("xyz", vectors.T, strict=True)))


def outline(vehicle: Vehicle, points: int = 25) -> list[Array]:
    """Polylines in body axes that draw a vehicle [m]: its arms, a nose and its propellers."""
    turn = np.linspace(0.0, 2 * np.pi, points)
    circle = vehicle.frame.prop_radius * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    nose = np.array([[0.0, 0.0, 0.0], [np.linalg.norm(vehicle.hubs, axis=1).max(), 0.0, 0.0]])
    arms = [np.stack([np.zeros(3), hub]) for hub in vehicle.hubs]
    return [nose, *arms, *(hub + circle for hub in vehicle.hubs)]


@contextmanager
def viewer_files(rerun: Path | None, mcap: Path | None) -> Iterator[Callable[[Timeline], None] | None]:
    """Check that files for viewers can be written, and give a function that writes them whole.

    Args:
        rerun: File for rerun, .rrd.
        mcap: File for Foxglove, .mcap.

    Returns:
        The function; None if no file is given.

    Raises:
        ValueError: Another suffix, or a file that another process writes.
        OSError: A file cannot be written there.
        ModuleNotFoundError: The package that writes it is not installed.
    """
    wanted = {".rrd": (rerun, "rerun", "rerun_file"), ".mcap": (mcap, "mcap.writer", "mcap_file")}
    files = {}
    with ExitStack() as stack:
        for suffix, (path, package, module) in wanted.items():
            if path is None:
                continue
            if path.suffix != suffix:
                raise ValueError(f"{path}: should end in {suffix}")
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
            importlib.import_module(package)
            files[path] = importlib.import_module(f".{module}", __package__).write
            stack.enter_context(alone(path))

        def write(timeline: Timeline) -> None:
            for path, to in files.items():
                replace(path.expanduser(), partial(to, timeline=timeline))

        yield write if files else None
