"""A user's recording of a vector over time, in CSV."""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .ranges import Between
from .toml import read_text

COLUMNS = ("t", "x", "y", "z")


def read_series(path: str | Path, within: Between, optional: str = "") -> NDArray[np.float64]:
    """Read columns t, x, y, z of a CSV file with a header, (T, 4), or (T, 5) with an optional column.

    Args:
        path: The file. Other columns are ignored.
        within: Range of x, y and z, with their unit. The time t must increase [s].
        optional: Name of a fifth column, which is zero if the file lacks it.

    Raises:
        ValueError: The file or a row is invalid; the message names the line.
    """
    rows: list[list[float]] = []
    lines: list[int] = []
    text = read_text(Path(path), most_mb=100.0).splitlines()
    above = next((k for k, line in enumerate(text) if line.strip()), 0)  # blank lines
    reader = csv.DictReader(text[above:], skipinitialspace=True)
    reader.fieldnames = header = [name.strip() for name in reader.fieldnames or ()]
    wanted = [*COLUMNS, *({optional} & set(header))]
    if any(header.count(name) != 1 for name in wanted):
        raise ValueError(
            f'{path}: the header is "{",".join(header)[:60]}"; '
            f"it should have each of {', '.join(wanted)} once"
        )
    try:
        for row in reader:
            if None in row:  # more cells than columns: with decimal commas, too
                raise ValueError
            rows.append([float(row[name]) for name in COLUMNS] + [float(row.get(optional) or 0.0)])
            lines.append(above + reader.line_num)
    except (csv.Error, TypeError, ValueError):
        raise ValueError(
            f"{path}, line {above + reader.line_num}: should have numbers in the columns "
            f"{', '.join(COLUMNS)}, and no more cells than the header"
        ) from None
    if len(rows) < 2:
        raise ValueError(f"{path}: {len(rows)} rows of {', '.join(COLUMNS)}; at least 2 are needed")
    table = np.array(rows)
    for row in np.flatnonzero(~np.isfinite(table).all(axis=1)):
        raise ValueError(f"{path}, line {lines[row]}: should have finite numbers")
    row = int(np.argmax(np.abs(table[:, 1:4]).max(axis=1)))
    for name, value in zip(COLUMNS[1:], table[row, 1:4], strict=True):
        within.of(f"{path}, line {lines[row]}: {name}", value)
    for row in np.flatnonzero(np.diff(table[:, 0]) <= 0.0) + 1:
        raise ValueError(
            f"{path}, line {lines[row]}: t = {table[row, 0]:g} s should be after the line before"
        )
    return table if optional else table[:, :4]
