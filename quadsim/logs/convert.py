"""Conversion of logs to a dataset, which can be used like a simulated one."""

import shutil
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
import xarray as xr

from ..dataset import store as dataset_store
from ..dataset.store import LABELS, VARIABLES, Plan, Recorded, partial_folder
from ..dataset.stretches import stretches
from ..runs.console import say
from ..runs.files import alone

READ = {"gyro": "gyro", "accel": "accel", "ang_vel": "gyro", "specific_force": "accel", "quat": "quat"}
"""For each variable of a dataset whose truth a log lacks, the measured variable that replaces it."""
WIDTH = {name: len(LABELS[each.dim]) for name, each in VARIABLES.items()}


def convert(logs: Sequence[xr.Dataset], out: Path, piece_s: float = 20.0) -> Path:
    """Cut logs into complete pieces of equal length, and write the pieces as flights.

    Args:
        logs: Logs from `read_log`, all with the same sample rate.
        out: Path of the dataset. It must not exist.
        piece_s: Length of a piece [s].

    Returns:
        The path of the dataset.

    Raises:
        ValueError: The logs have no gapless piece with a known attitude, or `out` exists.
    """
    out = out.expanduser().absolute()
    rates = {float(log.attrs["rate_hz"]) for log in logs}
    if len(rates) != 1:
        raise ValueError(f"logs at {sorted(rates)} Hz; one rate is required")
    rate_hz = rates.pop()
    steps = round(piece_s * rate_hz)
    with alone(out):
        if out.exists():
            raise ValueError(f"{out} exists already: move it, or choose another --out")
        pieces = [piece for log in logs for piece in _pieces(log, steps)]
        if not pieces:
            raise ValueError(
                f"no piece of {piece_s:g} s without a gap and with a known attitude: choose a shorter --piece"
            )
        held = {*READ} | ({"position"} if all("position" in log for log in logs) else set())
        if all(_has_rotors(piece) for piece in pieces):
            held.add("rotor_vel")
        names = tuple(str(log.attrs["source"]) for log in logs)
        unknown = tuple(name for name in VARIABLES if name not in held)
        plan = Plan(
            quadsim_version=version("quadsim"),
            seed=0,
            flights=len(pieces),
            steps=steps,
            rate_hz=rate_hz,
            code="",
            config=Recorded(logs=names, piece_s=piece_s, unknown=unknown),
        )
        folder = partial_folder(out)
        shutil.rmtree(folder, ignore_errors=True)
        out.parent.mkdir(parents=True, exist_ok=True)
        dataset_store.lay_out(folder, plan)
        for number, piece in enumerate(pieces):
            values = {name: np.zeros((1, steps, WIDTH[name]), "<f4") for name in VARIABLES}
            for name in held:
                values[name][0] = piece[READ.get(name, name)]
            dataset_store.write_flights(folder, [number], values, [(steps, "")])
        dataset_store.finish(folder, plan, out)
    total = sum(float(log.attrs["duration_s"]) for log in logs)
    share = 100 * len(pieces) * piece_s / total
    say(f"{out}: {len(pieces)} pieces of {piece_s:g} s, {share:.0f} % of {total:.0f} s")
    return out


def _pieces(log: xr.Dataset, steps: int) -> list[xr.Dataset]:
    """Yield pieces without missing samples, in order."""
    one = log.isel(flight=0)
    whole = np.logical_and.reduce([np.isfinite(one[name]).all(axis=-1) for name in ("gyro", "accel", "quat")])
    return [
        one.isel(time=slice(first, first + steps))
        for start, end in stretches(whole)
        for first in range(start, end + 1 - steps, steps)
    ]


def _has_rotors(piece: xr.Dataset) -> bool:
    """Return whether the speed of every rotor is known at all samples."""
    speeds = piece.get("rotor_vel", np.empty((1, 0)))
    return speeds.shape[-1] == WIDTH["rotor_vel"] and bool(np.isfinite(speeds).all())
