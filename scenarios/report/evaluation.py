"""Estimators compared on a dataset: a table, a CSV, pictures and a page, `quadsim evaluate --data`."""

from pathlib import Path

import estimators
from estimators.evaluation import figures
from estimators.evaluation.comparison import evaluate
from estimators.evaluation.flights import imu_of, vehicle_of
from estimators.registry import needs_vehicle, tuned_elsewhere
from quadsim.dataset.reading import open_dataset
from quadsim.runs.console import output, progress_bar
from quadsim.runs.files import save_figure

from .contenders import Contenders
from .page import OfflineSection, write_report
from .terminal import EVALUATION_METHOD, evaluation_columns, evaluation_notes, evaluation_table

FIGURES = {
    "violins": figures.violins,
    "error-over-time": figures.error_over_time,
    "convergence": figures.settling,
}


def evaluate_dataset(data: Path, contenders: Contenders, out: Path, *, slow_flights: int, seed: int) -> None:
    """Compare estimators on the flights of a dataset, and write and print the results.

    Args:
        data: The dataset.
        contenders: The estimators.
        out: Folder for evaluation.csv, report.html and the pictures.
        slow_flights: Flights that slow estimators are run on.
        seed: Of the bootstrap.
    """
    flights = open_dataset(data)
    airframe, imu = contenders.vehicle or vehicle_of(flights), imu_of(flights)
    every = [name for name in estimators.names() if airframe is not None or not needs_vehicle(name)]
    made = contenders.create(every, float(flights.attrs["rate_hz"]), airframe, imu)
    with progress_bar("evaluate", "runs") as bar:
        done = evaluate(flights, made, slow_flights=slow_flights, seed=seed, progress=bar)
    done.write_csv(out / "evaluation.csv")
    pictures = {n: save_figure(out / f"{n}.png", draw(done), dpi=130) for n, draw in FIGURES.items()}
    caption = f"{flights.sizes['flight']} flights of {data}, without a loop."
    notes = [*evaluation_notes(done.rows), *tuned_elsewhere(made, contenders.tuning, airframe, imu)]
    page = write_report(
        out / "report.html",
        offline=OfflineSection(evaluation_columns(done.rows), " ".join([caption, *notes]), pictures),
        title="Attitude estimators on recorded flights",
        footer=EVALUATION_METHOD,
        csv=["evaluation.csv"],
    )
    output.print(evaluation_table(done.rows, caption))
    for note in notes:
        output.print(note, soft_wrap=True)
    rated = [row for row in done.rows if row.initial == "unknown" and not row.unranked]
    last = f"{page}"
    if not rated:
        last += ": no estimator with an unknown start is ranked"
    else:
        best = min(rated, key=lambda row: row.behind_deg)
        tied = [r.estimator for r in rated if r.tied and r is not best and r.flights == best.flights]
        last += f": the smallest error from an unknown start is {best.estimator}'s, {best.mean_deg:.2f}°"
        last += f", not significantly different from {', '.join(tied)}" if tied else ""
    output.print(last, soft_wrap=True)
