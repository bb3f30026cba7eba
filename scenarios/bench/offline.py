"""Estimators on recorded flights, without a loop: the table of their errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import estimators
from estimators.evaluation.comparison import silenced_twin
from estimators.evaluation.flights import imu_of, other_sensors, vehicle_of
from estimators.metrics import attitude_error, flaw_of, inclination_rmse, share_without_number
from quadsim.dataset.reading import open_dataset
from quadsim.estimator import receives_truth
from quadsim.rotation import roll_pitch_from_quat

UNRANKED = "not ranked"
"""Column that says why an estimator is not ranked, "reference" or its flaw; empty if it is ranked."""


@dataclass(frozen=True)
class OfflineRow:
    """One estimator, one kind of start. Errors are of roll and pitch, one mean absolute error a flight."""

    estimator: str
    start: str
    """Initial attitude: "known", or "level" where it is unknown."""
    median_deg: float | None = None
    """Over flights, like mean and SD."""
    mean_deg: float | None = None
    sd_deg: float | None = None
    without_number: float | None = None
    """Share of estimates that are no finite number, each of which counts as 180°."""
    silenced_deg: float | None = None
    """Of a network: mean with output weights of zero."""
    inclination_rmse_deg: float | None = None
    note: str | None = None
    """Why it failed."""
    reference: bool = False
    """Whether it receives the true attitude."""
    flaw: str = ""
    """What is wrong with its estimates, as of `estimators.metrics.flaw_of`; empty if nothing."""

    @property
    def unranked(self) -> str:
        """Why it is not ranked; empty if it is."""
        return "reference" if self.reference else self.flaw


def offline_errors(dataset: str | Path, names: Sequence[str]) -> list[OfflineRow]:
    """Errors of estimators on a dataset, from a known (not networks) and an unknown initial attitude."""
    data = open_dataset(dataset)
    rate_hz = float(data.attrs["rate_hz"])
    gyro, accel, quat = (data[name].to_numpy().astype(np.float64) for name in ("gyro", "accel", "quat"))
    truth, others = roll_pitch_from_quat(quat), other_sensors(data)
    valid = np.arange(truth.shape[1]) < data["valid_steps"].to_numpy()[:, None]
    counted = np.where(valid[..., None], truth, np.nan)
    rows: list[OfflineRow] = []
    for name in names:
        twin = silenced_twin(name, rate_hz)
        starts = {"level": None} if twin else {"known": truth[:, 0], "level": None}
        for start, roll_pitch in starts.items():
            try:
                estimator = estimators.create(name, rate_hz, vehicle=vehicle_of(data), imu=imu_of(data))
                estimate = estimators.run(estimator, gyro, accel, roll_pitch, quat, **others)
            except (ValueError, OSError) as error:
                rows.append(OfflineRow(name, start, note=str(error)))
                continue
            error, inclination = attitude_error(estimate, counted), inclination_rmse(estimate, counted).mean
            silenced = twin and attitude_error(estimators.run(twin, gyro, accel), counted).mean
            share = share_without_number(estimate, counted)
            errors = error.median, error.mean, error.sd, share, silenced, inclination
            flaw = flaw_of(estimate, counted)
            rows.append(OfflineRow(name, start, *errors, reference=receives_truth(estimator), flaw=flaw))
    return rows


def table_of(rows: Sequence[OfflineRow]) -> list[dict[str, object]]:
    """The rows by column; without the columns of notes, and of what is not ranked, if they would be empty."""
    noted, unranked = any(row.note for row in rows), any(row.unranked for row in rows)
    left_out = {"reference", "flaw"} | ({"note"} if not noted else set())
    table: list[dict[str, object]] = []
    for row in rows:
        table.append({key: value for key, value in vars(row).items() if key not in left_out})
        if unranked:
            table[-1][UNRANKED] = row.unranked
    return table
