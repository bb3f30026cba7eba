"""Estimators on recorded flights, without a loop: the table of their errors."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import estimators
from estimators.evaluation.comparison import silenced_twin
from estimators.evaluation.flights import imu_of, other_sensors, vehicle_of
from estimators.metrics import attitude_error, inclination_rmse, share_without_number
from quadsim.dataset.reading import open_dataset
from quadsim.rotation import roll_pitch_from_quat

Row = dict[str, float | int | str | None]


def offline_errors(dataset: str | Path, names: Sequence[str]) -> list[Row]:
    """Errors of estimators on all flights of a dataset, from a known and from an unknown start.

    Networks are never given the initial attitude: they have the unknown start alone.

    Args:
        dataset: Path of a dataset.
        names: Names of estimators.

    Returns:
        One row per estimator and start: estimator, start, median_deg, mean_deg, sd_deg over flights of the
        mean absolute error of roll and pitch, inclination_rmse_deg; of a network silenced_deg, the mean with
        output weights of zero. without_number is the share of estimates that are no finite number, each of
        which counts as 180°. An estimator that fails has its reason in `note`.
    """
    data = open_dataset(dataset)
    rate_hz = float(data.attrs["rate_hz"])
    gyro, accel, quat = (data[name].to_numpy().astype(np.float64) for name in ("gyro", "accel", "quat"))
    truth, others = roll_pitch_from_quat(quat), other_sensors(data)
    flown = np.arange(truth.shape[1]) < data["valid_steps"].to_numpy()[:, None]
    counted = np.where(flown[..., None], truth, np.nan)
    rows: list[Row] = []
    for name in names:
        twin = silenced_twin(name, rate_hz)
        starts = {"level": None} if twin else {"known": truth[:, 0], "level": None}
        for start, roll_pitch in starts.items():
            row: Row = {"estimator": name, "start": start}
            try:
                estimator = estimators.create(name, rate_hz, vehicle=vehicle_of(data), imu=imu_of(data))
                estimate = estimators.run(estimator, gyro, accel, roll_pitch, quat, **others)
            except (ValueError, OSError) as error:
                rows.append(row | {"note": str(error)})
                continue
            error = attitude_error(estimate, counted)
            row |= {"median_deg": error.median, "mean_deg": error.mean, "sd_deg": error.sd}
            row |= {"without_number": share_without_number(estimate, counted)}
            silent = None if twin is None else attitude_error(estimators.run(twin, gyro, accel), counted).mean
            rows.append(
                row
                | {"silenced_deg": silent, "inclination_rmse_deg": inclination_rmse(estimate, counted).mean}
            )
    return rows
