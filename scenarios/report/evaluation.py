"""Comparison of estimators on a dataset for `quadsim evaluate --data`: table, CSV, pictures and page."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import estimators
from estimators.evaluation import error_figures
from estimators.evaluation.comparison import SETTLED_DEG, Evaluation, behind_the_best, evaluate, made_of
from estimators.evaluation.flights import imu_of, vehicle_of
from estimators.registry import needs_vehicle, tuned_elsewhere
from quadsim.dataset.reading import open_dataset
from quadsim.runs.console import output, progress_bar
from quadsim.runs.files import save_figure

from .page import OfflineSection, write_report
from .terminal import rows_table

FIGURES = {
    "violins": error_figures.violins,
    "convergence": error_figures.settling,
}

SLOW_FLIGHTS = 4
"""Number of flights for filterpy's filters, which are hundreds of times slower than the others."""
METHOD = (
    "The error of a flight is the mean absolute error of roll and pitch. The table gives its median, mean "
    "and standard deviation over flights; the 95 % interval of the mean is a bootstrap interval. 'Silenced' "
    "is the mean error of the same network with output weights of zero. 'Error minus the best' is the paired "
    "difference from the best estimator; two estimators are tied if its interval includes 0. '20° to 2°' is "
    "the time from a start in an unknown tilt of 20° until the median inclination error stays below 2°; a "
    "dash means that it never does. Networks are never given the initial attitude, so they have no row with "
    "a known start. A reference receives the true attitude and is not ranked. Estimators that failed or have "
    "a flaw are not ranked either."
)


def evaluate_dataset(
    data: Path,
    out: Path,
    names: Sequence[str] | None,
    tuning: str | None,
    vehicle: str | None,
    *,
    seed: int,
) -> None:
    """Compare estimators on the flights of a dataset, and write and print the results.

    Args:
        data: The dataset.
        out: Folder for evaluation.csv, report.html and the pictures.
        names: The estimators; None for all that can be made.
        tuning: Source of the parameters, as in `estimators.create`.
        vehicle: The airframe; None for that of the dataset.
        seed: Seed of the bootstrap.
    """
    flights = open_dataset(data)
    airframe, imu = vehicle or vehicle_of(flights), imu_of(flights)
    every = [name for name in estimators.names() if airframe is not None or not needs_vehicle(name)]
    made = made_of(names or every, float(flights.attrs["rate_hz"]), tuning, airframe, imu)
    with progress_bar("evaluate", "runs") as bar:
        done = evaluate(flights, made, slow_flights=SLOW_FLIGHTS, seed=seed, progress=bar)
    done.write_csv(out / "evaluation.csv")
    figures = {name: draw for name, draw in FIGURES.items() if done.tilts_deg or name != "convergence"}
    pictures = {n: save_figure(out / f"{n}.png", draw(done), dpi=130) for n, draw in figures.items()}
    caption = f"{flights.sizes['flight']} flights of {data}, scored outside the loop."
    notes = [*evaluation_notes(done), *tuned_elsewhere(made, tuning, airframe, imu)]
    page = write_report(
        out / "report.html",
        offline=recorded_section(done, " ".join([caption, *notes]), pictures),
        title="Attitude estimators outside the loop",
        footer=METHOD,
        files=["evaluation.csv"],
    )
    output.print(rows_table(columns(done), caption))
    for note in notes:
        output.print(note, soft_wrap=True)
    output.print(f"{page}: {headline(done.rows)}", soft_wrap=True)


def recorded_section(
    done: Evaluation, caption: str, pictures: Mapping[str, Path] | None = None
) -> OfflineSection:
    """Return the section of a report."""
    found = headline(done.rows)
    return OfflineSection(columns(done), caption, pictures or {}, f"On these flights, {found}.")


def headline(rows: Sequence[Any]) -> str:
    """Name the estimator with the smallest error from an unknown start, and those tied with it."""
    rated = [row for row in rows if row.initial == "unknown" and not row.unranked]
    if not rated:
        return "no estimator with an unknown start is ranked"
    best = min(rated, key=lambda row: row.behind_deg)
    tied = [row.estimator for row in rated if row.tied and row is not best and row.flights == best.flights]
    text = f"{best.estimator} has the smallest error from an unknown start, {best.mean_deg:.2f}°"
    return text + (f"; the difference from {', '.join(tied)} is not significant" if tied else "")


def columns(done: Evaluation) -> list[dict[str, object]]:
    """Return the rows for tables; unknown values are None."""
    return [
        {
            "estimator": row.estimator,
            "start": row.initial,
            "median [°]": _known(row.median_deg),
            "mean [°]": _known(row.mean_deg),
            "95 %": f"{row.mean_low_deg:.2f}–{row.mean_high_deg:.2f}" if row.flights > 1 else None,
            "SD [°]": row.sd_deg if row.flights > 1 else None,
            "silenced [°]": _known(row.silenced_deg),
            "error minus the best [°]": behind_the_best(row),
            "inclination [°]": _known(row.inclination_rmse_deg),
            **{
                f"{tilt:g}° to {SETTLED_DEG:g}° [s]": _known(getattr(row, f"settle_{tilt:g}_s"))
                for tilt in done.tilts_deg
            },
            "time [µs]": _known(row.runtime_ns / 1e3),
        }
        for row in done.rows
    ]


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def evaluation_notes(done: Evaluation) -> list[str]:
    """Return notes that explain the table."""
    notes, rows = [], done.rows
    if not done.tilts_deg:
        notes.append("The flights are too short or too level to measure convergence from a wrong start.")
    most = max(row.flights for row in rows)
    fewer = {row.estimator: row.flights for row in rows if 0 < row.flights < most}
    if fewer:
        flights = ", ".join(f"{name} on the first {count}" for name, count in fewer.items())
        notes.append(f"Slow estimators were run on fewer flights: {flights}.")
    missing = max(row.missing for row in rows)
    if missing > 0:
        notes.append(
            f"{missing} samples were missing or beyond any sensor's range; the estimators predicted "
            "the attitude there."
        )
    flaws: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.flaw:
            flaws.setdefault((row.estimator, row.flaw), []).append(row.initial)
    for (name, flaw), starts in flaws.items():
        counted = " Each of these counts as 180°." * any(
            r.without_number > 0.0 for r in rows if r.flaw == flaw
        )
        notes.append(f"{name} is not ranked ({' and '.join(starts)} start): it {flaw.rstrip('.')}.{counted}")
    if references := dict.fromkeys(row.estimator for row in rows if row.unranked == "reference"):
        verbs = ("receives", "is") if len(references) == 1 else ("receive", "are")
        notes.append(f"{', '.join(references)} {verbs[0]} the true attitude and {verbs[1]} not ranked.")
    return notes
