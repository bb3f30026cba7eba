"""The paper's Table 1: errors on flights of a network's own and of other domains, over the folds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from rich.table import Column, Table

from estimators.appearance import looks
from quadsim.dataset.figures import STYLE
from quadsim.runs.files import save_figure

TRAIN, TEST = "(train)", "(test)"


@dataclass(frozen=True)
class Score:
    """Error of one fold's network on one set of flights."""

    model: str
    trained_on: str
    fold: int
    tested_on: str
    """Its own training flights, "(train)", its held-out flights, "(test)", or the name of another domain."""
    flights: int
    error_deg: float
    """Mean absolute error of roll and pitch over complete flights, unknown initial attitude."""
    flight_sd_deg: float
    """Standard deviation of the flights' errors."""
    epoch: int
    """The best one, counted from 1."""
    flaw: str = ""
    """What is wrong with its estimates, as of `estimators.metrics.flaw_of`; empty if nothing."""


@dataclass(frozen=True)
class TableEntry:
    """An entry of Table 1: mean and standard deviation over the folds."""

    model: str
    trained_on: str
    tested_on: str
    folds: int
    mean_deg: float
    sd_deg: float
    flawed: int = 0
    """Folds whose network's estimates have a flaw; they count, with 180° where there is no angle."""


def table(scores: Sequence[Score]) -> list[TableEntry]:
    """Mean and standard deviation over the folds, in the order in which they first come."""
    keys = dict.fromkeys((s.model, s.trained_on, s.tested_on) for s in scores)
    cells = []
    for key in keys:
        of_folds = [s for s in scores if (s.model, s.trained_on, s.tested_on) == key]
        errors, flawed = [s.error_deg for s in of_folds], sum(bool(s.flaw) for s in of_folds)
        mean, sd = float(np.mean(errors)), float(np.std(errors, ddof=1))
        cells.append(TableEntry(*key, len(errors), mean, sd, flawed))
    return cells


def best(cells: Sequence[TableEntry]) -> TableEntry:
    """The smallest error on unseen flights, of those without a flawed fold.

    Raises:
        ValueError: Every model has one in every domain.
    """
    own = [cell for cell in cells if cell.tested_on == TEST]
    sound = [cell for cell in own if not cell.flawed]
    if not sound:
        folds = ", ".join(f"{c.model} on {c.trained_on}: {c.flawed} of {c.folds}" for c in own)
        raise ValueError(f"no network can be ranked; folds with a flaw: {folds} (see kfold.csv)")
    return min(sound, key=lambda cell: cell.mean_deg)


def terminal_table(cells: Sequence[TableEntry]) -> Table:
    """A row for each model and domain that it was trained on, a column for what it was tested on."""
    tested = list(dict.fromkeys(cell.tested_on for cell in cells))
    rows = {(cell.model, cell.trained_on): {} for cell in cells}
    for cell in cells:
        flawed = f" ({cell.flawed} flawed)" if cell.flawed else ""
        error = f"{cell.mean_deg:.2f} ± {cell.sd_deg:.2f}{flawed}"
        rows[cell.model, cell.trained_on][cell.tested_on] = error
    title = f"Mean absolute error of roll and pitch, mean ± SD over {cells[0].folds} folds, °"
    own = {TRAIN: "its training flights", TEST: "its unseen flights"}
    headings = (Column(own.get(name, f"all of {name}"), justify="right") for name in tested)
    shown = Table("model", "trained on", *headings, title=title)
    for (model, domain), errors in rows.items():
        shown.add_row(model, domain, *(errors.get(name, "") for name in tested))
    return shown


def plot(path: Path, scores: Sequence[Score]) -> None:
    """Every fold's error as a dot, one column for each entry of Table 1, with mean and standard deviation."""
    cells = table(scores)
    appearance = looks(cell.model for cell in cells)
    with rc_context(STYLE):
        figure = Figure(figsize=(1.6 + 0.75 * len(cells), 3.4), layout="constrained")
        axes = figure.subplots()
        for k, cell in enumerate(cells):
            key = cell.model, cell.trained_on, cell.tested_on
            errors = [s.error_deg for s in scores if (s.model, s.trained_on, s.tested_on) == key]
            colour, _, marker = appearance[cell.model]
            axes.plot(np.full(len(errors), k) + 0.16, errors, marker, ms=4, mfc="none", color=colour)
            axes.errorbar(k - 0.12, cell.mean_deg, cell.sd_deg, fmt=marker, ms=5, color=colour, capsize=3)
        for model, (colour, _, marker) in appearance.items():
            axes.plot([], [], marker, color=colour, label=model)
        labels = [f"{cell.trained_on}\n{cell.tested_on}" for cell in cells]
        axes.set_xticks(range(len(cells)), labels, rotation=0 if len(cells) < 9 else 45)
        axes.set(ylabel="mean absolute error [°]", xlabel="trained on, and below it tested on")
        axes.set(ylim=(0, 1.15 * max(s.error_deg for s in scores)), xlim=(-0.6, len(cells) - 0.4))
        axes.grid(axis="x", visible=False)
        axes.legend(title="folds (open), mean ± SD")
        save_figure(path, figure, dpi=150)
