"""CSV files, described by a TOML file with names, units, axes and sample rate."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import model_validator

from ...config.ranges import Between, SampleRate
from ...config.toml import Strict, load_toml, nearest
from ...rotation import quat_conjugate, quat_from_euler, wxyz_from_xyzw
from ..recording import Array, AxesConvention, Recording, Track, TruthAxes, from_frd, mount_matrix, mounted

Column = str | Annotated[int, Between(0, 9999)]
"""Column of the CSV file: a name in the header, or an index from 0."""
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "gyro": {"rad/s": 1.0, "deg/s": math.pi / 180},
    "accel": {"m/s^2": 1.0, "g": 9.80665, "mg": 9.80665e-3},
    "euler": {"rad": 1.0, "deg": math.pi / 180},
    "rotor_vel": {"rad/s": 1.0, "rpm": math.pi / 30},
    "mag": {"T": 1.0, "uT": 1e-6, "G": 1e-4},
}
"""Allowed units of each part and their values in SI units; the first is the default."""


class Time(Strict):
    """Time stamps: a column, or a sample rate if there is no such column."""

    column: Column | None = None
    unit: str = "s"
    rate_hz: SampleRate | None = None
    """Samples per second, for a file without time stamps."""

    @model_validator(mode="after")
    def _check(self) -> "Time":
        if (self.column is None) == (self.rate_hz is None):
            raise ValueError("one of column and rate_hz is required")
        return self


class Columns(Strict):
    """Three columns, of a sensor or of roll, pitch and yaw (intrinsic z-y'-x'')."""

    columns: tuple[Column, ...]
    unit: str | None = None
    """Unit of the columns; empty for the SI unit."""


class Accel(Columns):
    """The three columns of the accelerometer."""

    negate: bool = False
    """Whether the sign is inverted: at rest, the columns contain gravity, which points down."""


class Quat(Strict):
    """True attitude as a quaternion."""

    columns: tuple[Column, Column, Column, Column]
    order: Literal["wxyz", "xyzw"] = "wxyz"
    direction: Literal["body_to_world", "world_to_body"] = "body_to_world"


class Table(Strict):
    """Description of the columns of a CSV file."""

    file: str
    """The CSV file; a relative path starts from the folder of the TOML file."""
    delimiter: str = ","
    header: bool = True
    """Whether the first row contains names."""
    frame: AxesConvention = "flu"
    """Axes of the file. flu: body axes forward-left-up, world z up. frd: forward-right-down in a
    north-east-down world."""
    mount: str = "x,y,z"
    """Rotation from IMU axes to body axes, in the notation of `--mount`."""
    truth_axes: TruthAxes = "body"
    """Whether the file contains the attitude of the body, or of the IMU, which the mount also rotates."""
    time: Time
    gyro: Columns
    accel: Accel
    quat: Quat | None = None
    euler: Columns | None = None
    """True attitude as roll, pitch and yaw, intrinsic z-y'-x''."""
    position: tuple[Column, Column, Column] | None = None
    """Columns of the position [m]."""
    rotor_vel: Columns | None = None
    """Columns of the rotor speeds, one per rotor."""
    mag: Columns | None = None

    @model_validator(mode="after")
    def _check(self) -> "Table":
        mount_matrix(self.mount)
        for name, units in UNITS.items():
            part: Time | Columns | None = getattr(self, name)
            if part is not None and part.unit not in (None, *units):
                raise ValueError(f'{name}.unit = "{part.unit}": should be {" or ".join(units)}')
            if isinstance(part, Columns) and name != "rotor_vel" and len(part.columns) != 3:
                raise ValueError(f"{name}.columns: {len(part.columns)}; three are required")
            if isinstance(part, Columns) and len({*part.columns}) < len(part.columns):
                raise ValueError(f"{name}.columns: {', '.join(map(str, part.columns))}; one is there twice")
        if self.quat is not None and self.euler is not None:
            raise ValueError("one of quat and euler is required, not both")
        return self


def read_table(path: Path) -> Recording:
    """Read the CSV file that a TOML file describes.

    Args:
        path: The TOML file.

    Raises:
        ValueError: The description is invalid, a column is missing, or a value is not a number.
    """
    spec = load_toml(path, "logs", Table)
    file = path.parent / spec.file
    if not file.is_file():
        raise FileNotFoundError(f"{path}: file = {spec.file}: no such file")
    names, values = _rows(file, spec)

    def columns(wanted: Sequence[Column]) -> Array:
        return values[:, [_index(file, names, values.shape[1], each) for each in wanted]]

    def read(name: str) -> Array:
        part: Columns = getattr(spec, name)
        return columns(part.columns) * UNITS[name][part.unit or next(iter(UNITS[name]))]

    time = np.arange(len(values)) / (spec.time.rate_hz or 1.0)
    if spec.time.column is not None:
        time = columns([spec.time.column])[:, 0] * UNITS["time"][spec.time.unit]
    sensors = {name: Track(time, read(name)) for name in ("rotor_vel", "mag") if getattr(spec, name)}
    accel, notes = read("accel") * (-1 if spec.accel.negate else 1), (f"columns by {path.name}",)
    log = Recording(path.stem, "CSV", time, read("gyro"), accel, notes=notes, sensors=sensors)
    quat, of = None, "the quaternion of the file"
    if spec.quat is not None:
        quat = columns(spec.quat.columns)
        quat = wxyz_from_xyzw(quat) if spec.quat.order == "xyzw" else quat
        quat = quat_conjugate(quat) if spec.quat.direction == "world_to_body" else quat
    elif spec.euler is not None:
        quat, of = quat_from_euler(*read("euler").T), "roll, pitch and yaw of the file"
    if quat is not None:
        position = columns(spec.position) if spec.position else None
        log = log.with_truth(of, time, quat, position, spec.truth_axes == "imu")
    log = log if spec.mount == "x,y,z" else mounted(log, mount_matrix(spec.mount))
    return from_frd(log) if spec.frame == "frd" else log


def _rows(file: Path, spec: Table) -> tuple[list[str], Array]:
    """Return the names of the columns and all numbers; an empty field is NaN."""
    try:
        cells = pd.read_csv(
            file, sep=spec.delimiter, header=None, dtype=str, encoding="utf-8-sig", skipinitialspace=True
        )
    except ValueError as error:  # such as rows of several widths
        raise ValueError(f"{file}: {error}") from error
    names = []
    if spec.header:
        names = [str(name).strip().lstrip("#").strip() for name in cells.iloc[0]]
        cells = cells.iloc[1:]
    numbers = cells.apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    for row, column in np.argwhere(np.isnan(numbers) & cells.notna().to_numpy())[:1]:
        cell = str(cells.iat[row, column])
        hint = '; is delimiter = ";" what it has?' if ";" in cell else ""
        where = f"row {row + 1} of the numbers, column {column + 1}"
        raise ValueError(f"{file}: {where}: {cell[:40]!r} is no number{hint}")
    if len(numbers) < 2:
        raise ValueError(f"{file}: at least 2 rows of numbers are required")
    return names, numbers


def _index(file: Path, names: list[str], width: int, column: Column) -> int:
    if isinstance(column, int):
        if 0 <= column < width:
            return column
        raise ValueError(f"{file}: no column {column}, there are {width}")
    if column not in names:
        raise ValueError(f'{file}: no column "{column}"; {nearest(column, names) if names else "no header"}')
    return names.index(column)
