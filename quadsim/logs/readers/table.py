"""Any CSV, by a TOML file that says what its columns are: names, units, axes and rate."""

import csv
import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import model_validator

from ...config.ranges import Between, SampleRate
from ...config.toml import Strict, load_toml, nearest
from ...rotation import quat_conjugate, quat_from_euler, wxyz_from_xyzw
from ..mounting import mount_matrix, mounted
from ..recording import Array, AxesConvention, Recording, Track, TruthAxes, from_frd

Column = str | Annotated[int, Between(0, 9999)]
"""A name in the header, or a number counted from 0."""
Three = tuple[Column, Column, Column]
Four = tuple[Column, Column, Column, Column]

Component = Annotated[float, Between(-1.1, 1.1)]
"""Of a quaternion or a rotation matrix, rounding included."""

TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
RATES = {"rad/s": 1.0, "deg/s": math.pi / 180}
FORCES = {"m/s^2": 1.0, "g": 9.80665, "mg": 9.80665e-3}
SPEEDS = {"rad/s": 1.0, "rpm": math.pi / 30}
FIELDS = {"T": 1.0, "uT": 1e-6, "G": 1e-4}
ANGLES = {"rad": 1.0, "deg": math.pi / 180}


class Time(Strict):
    """Stamps: a column, or a rate where there is none."""

    column: Column | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: SampleRate | None = None
    """Samples per second of a file without stamps."""

    @model_validator(mode="after")
    def _check(self) -> "Time":
        if (self.column is None) == (self.rate_hz is None):
            raise ValueError("one of column and rate_hz is required")
        return self


class Gyro(Strict):
    """The three columns of the gyroscope."""

    columns: Three
    unit: Literal["rad/s", "deg/s"] = "rad/s"


class Accel(Strict):
    """The three columns of the accelerometer."""

    columns: Three
    unit: Literal["m/s^2", "g", "mg"] = "m/s^2"
    negate: bool = False
    """The file holds gravity (at rest it points down) in place of specific force."""


class Rotors(Strict):
    """The columns of the rotor speeds, one a rotor."""

    columns: tuple[Column, ...]
    unit: Literal["rad/s", "rpm"] = "rad/s"


class Mag(Strict):
    """The three columns of the magnetometer."""

    columns: Three
    unit: Literal["T", "uT", "G"] = "T"


class Quat(Strict):
    """True attitude as a quaternion."""

    columns: Four
    order: Literal["wxyz", "xyzw"] = "wxyz"
    direction: Literal["body_to_world", "world_to_body"] = "body_to_world"


class Euler(Strict):
    """True attitude as roll, pitch and yaw, intrinsic z-y'-x''."""

    columns: Three
    unit: Literal["rad", "deg"] = "rad"


class Table(Strict):
    """What the columns of a CSV are."""

    file: str
    """The CSV, from the folder of this TOML."""
    delimiter: str = ","
    header: bool = True
    """The first row that is read holds names."""
    skip_rows: Annotated[int, Between(0, 10**6)] = 0
    """Rows before that."""
    frame: AxesConvention = "flu"
    """flu: body forward-left-up, world z up; frd: forward-right-down in north-east-down."""
    mount: str | tuple[Component, ...] | tuple[tuple[Component, ...], ...] = "x,y,z"
    """Rotation from IMU axes to those of the frame: axes "z,-y,x", angles "rpy 0 20 90" [deg], a quaternion
    [w, x, y, z] or a matrix of three rows."""
    truth_axes: TruthAxes = "body"
    """Whose attitude the file holds: of the frame already, or of the IMU, which the mount rotates too."""
    time: Time
    gyro: Gyro
    accel: Accel
    quat: Quat | None = None
    euler: Euler | None = None
    position: Three | None = None
    """Columns of the position [m]."""
    rotor_vel: Rotors | None = None
    mag: Mag | None = None

    @model_validator(mode="after")
    def _check(self) -> "Table":
        mount_matrix(self.mount)
        if self.quat is not None and self.euler is not None:
            raise ValueError("one of quat and euler is required, not both")
        return self


def read_table(path: Path) -> Recording:
    """Read the CSV that a column map names.

    Args:
        path: The TOML file.

    Raises:
        ValueError: One line: a bad map, a column that is not there, or a value that is no number.
    """
    spec = load_toml(path, "logs", Table)
    file = path.parent / spec.file
    if not file.is_file():
        raise FileNotFoundError(f"{path}: file = {spec.file}: no such file")
    names, values = _rows(file, spec)

    def columns(wanted: tuple[Column, ...]) -> Array:
        return values[:, [_index(file, names, values.shape[1], each) for each in wanted]]

    if spec.time.column is not None:
        time = columns((spec.time.column,))[:, 0] * TIMES[spec.time.unit]
    else:
        time = np.arange(len(values)) / (spec.time.rate_hz or 1.0)
    gyro = columns(spec.gyro.columns) * RATES[spec.gyro.unit]
    accel = columns(spec.accel.columns) * FORCES[spec.accel.unit] * (-1 if spec.accel.negate else 1)
    quat, truth = None, "none"
    if spec.quat is not None:
        quat, truth = columns(spec.quat.columns), "the quaternion of the file"
        quat = wxyz_from_xyzw(quat) if spec.quat.order == "xyzw" else quat
        quat = quat_conjugate(quat) if spec.quat.direction == "world_to_body" else quat
    elif spec.euler is not None:
        angles = columns(spec.euler.columns) * ANGLES[spec.euler.unit]
        quat, truth = quat_from_euler(*angles.T), "roll, pitch and yaw of the file"
    sensors = {}
    if spec.rotor_vel is not None:
        sensors["rotor_vel"] = Track(time, columns(spec.rotor_vel.columns) * SPEEDS[spec.rotor_vel.unit])
    if spec.mag is not None:
        sensors["mag"] = Track(time, columns(spec.mag.columns) * FIELDS[spec.mag.unit])
    known = np.full(len(values), False) if quat is None else np.isfinite(quat).all(axis=1)
    log = Recording(
        path.stem, "CSV", time, gyro, accel, truth=truth,
        truth_time=None if quat is None else time[known], quat=None if quat is None else quat[known],
        truth_axes=spec.truth_axes,
        position=None if quat is None or spec.position is None else columns(spec.position)[known],
        notes=(f"columns by {path.name}",), sensors=sensors,
    )  # fmt: skip
    log = log if spec.mount == "x,y,z" else mounted(log, spec.mount)
    return from_frd(log) if spec.frame == "frd" else log


def _rows(file: Path, spec: Table) -> tuple[list[str], Array]:
    """Names of the columns, and all numbers; an empty field is NaN."""
    with file.open(newline="", encoding="utf-8-sig") as stream:
        rows = [row for row in csv.reader(stream, delimiter=spec.delimiter) if row][spec.skip_rows :]
    names = [name.strip().lstrip("#").strip() for name in rows.pop(0)] if spec.header and rows else []
    widths = {len(row) for row in rows}
    if len(rows) < 2 or len(widths) != 1:
        raise ValueError(f"{file}: at least 2 rows of one width are required, found widths {sorted(widths)}")
    numbers = np.full((len(rows), widths.pop()), math.nan)
    for r, row in enumerate(rows):
        for c, cell in enumerate(row):
            try:
                numbers[r, c] = float(cell) if cell.strip() else math.nan
            except ValueError as error:
                hint = '; is delimiter = ";" what it has?' if ";" in cell else ""
                raise ValueError(
                    f"{file}: row {r + 1} of the numbers, column {c + 1}: {cell[:40]!r} is no number{hint}"
                ) from error
    return names, numbers


def _index(file: Path, names: list[str], width: int, column: Column) -> int:
    if isinstance(column, int):
        if 0 <= column < width:
            return column
        raise ValueError(f"{file}: no column {column}, there are {width}")
    if column not in names:
        raise ValueError(f'{file}: no column "{column}"; {nearest(column, names) if names else "no header"}')
    return names.index(column)
