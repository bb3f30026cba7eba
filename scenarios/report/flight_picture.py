"""A flight as one picture: the vehicle at several instants, and its path."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadsim.pictures.render import Image, View, still
from quadsim.rotation import quat_from_euler
from quadsim.vehicle import Vehicle, load_vehicle

from ..bench.cell import Cell
from ..bench.series import unpack_series

SHOWN = {"step": (1.9, 4.2), "figure-8": (5.5, 10.0), "racing": (0.5, 5.0)}
"""Scenarios that make a good picture, best first, and the part to show [s]; else the longest flight."""
PREFERRED = ("att-snn-loihi", "ekf")
"""Whose flight to show, if it was simulated."""
SHORTEST_S = 0.5
"""A flight that is too short for a picture [s]."""


class Picture(NamedTuple):
    """A rendered still."""

    image: Image  #: (height, width, 3)
    caption: str


def cover(cells: Sequence[Cell], vehicle: str = "hummingbird") -> tuple[Picture | None, str]:
    """A picture for the top of a report, or None and the reason why there is none."""
    flown = {
        (cell.scenario, cell.estimator): float(unpack_series(cell.series)["time"][-1])
        for cell in cells
        if cell.series
    }
    simulated = {(cell.scenario, cell.estimator): cell for cell in cells}
    names = [*PREFERRED, *(estimator for _, estimator in flown)]
    good = ((s, e) for s in SHOWN for e in names if flown.get((s, e), 0.0) > SHOWN[s][0])
    key = next(good, None) or max(flown, key=lambda key: flown[key], default=None)
    if key is None or flown[key] < SHORTEST_S:
        return None, f"The report shows no vehicle: no flight lasted {SHORTEST_S:g} s."
    chosen = simulated[key]
    start, end = SHOWN.get(chosen.scenario, (0.0, flown[key]))
    try:
        image = flight_picture(chosen, load_vehicle(vehicle), start, end)
    except RuntimeError as error:
        return None, str(error)
    return Picture(image, f"{chosen.scenario} with {chosen.estimator}, from {start:g} s to {end:g} s"), ""


def flight_picture(
    cell: Cell,
    vehicle: Vehicle,
    start_s: float = 0.0,
    end_s: float | None = None,
    exposures: int = 6,
    width: int = 1200,
    height: int = 675,
) -> Image:
    """A part of a flight with as many exposures, evenly spaced along the path.

    Raises:
        RuntimeError: If there is no headless OpenGL; the message says what to install.
        ValueError: If the cell did not run.
    """
    if not cell.series:
        raise ValueError(f"{cell.scenario} with {cell.estimator} did not run: {cell.reason}")
    s = unpack_series(cell.series)
    part = (s["time"] >= start_s) & (s["time"] <= (np.inf if end_s is None else end_s))
    place = np.stack([s["x"], s["y"], s["z"]], axis=-1)[part]
    roll, pitch, yaw = (np.radians(s[name][part]) for name in ("roll", "pitch", "yaw"))
    quat = quat_from_euler(roll, pitch, yaw)
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))])
    shown = np.unique(np.searchsorted(path, np.linspace(0.0, path[-1], exposures)).clip(max=len(path) - 1))
    low, high = place.min(axis=0), place.max(axis=0)
    target = 0.5 * (low + high)
    along = np.degrees(np.arctan2(*(place[-1] - place[0])[1::-1]))
    view = View(
        tuple(target), 0.8 + 0.95 * float(np.linalg.norm(high - low)), azimuth=along + 70.0, elevation=-12.0
    )
    return still(vehicle, place[shown], quat[shown], view, place, width, height)
