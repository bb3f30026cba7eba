"""The real recordings that pages score estimators on. They are not part of the repository.

A folder holds `broad/` (trials of the BROAD benchmark, Laidig et al. 2021, CC BY 4.0: hand-moved, 286 Hz,
optical truth) and `phantom4/` (flights of a DJI Phantom 4 RTK, Hurwitz & Klein 2023, CC BY 4.0: 120 Hz, truth
by the sensor's own filter).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import xarray as xr

from estimators import create
from estimators.evaluation.logs import LogScores, score_logs
from quadsim.estimator import AttitudeEstimator
from quadsim.logs import read_log

BROAD, PHANTOM4 = "BROAD", "Phantom 4"
FOLDERS = {BROAD: "broad", PHANTOM4: "phantom4"}
SKIP_S = {BROAD: 3.0, PHANTOM4: 5.0}
"""Time at the start of a recording that is not scored [s]."""
WITHIN_DEG = 180.0
RATE_HZ = 200.0
VQF_DEFAULTS = {
    "tauAcc": 3.0,
    "biasForgettingTime": 100.0,
    "biasSigmaInit": 0.5,
    "biasSigmaMotion": 0.1,
    "biasSigmaRest": 0.03,
}


def recordings(folder: Path) -> dict[str, list[xr.Dataset]]:
    """Both sets, resampled to 200 Hz.

    Raises:
        SystemExit: A set is not in the folder.
    """
    sets = {name: sorted((folder / place).glob("*.npz")) for name, place in FOLDERS.items()}
    if missing := [name for name, paths in sets.items() if not paths]:
        raise SystemExit(
            f"{folder}: no recordings of {', '.join(missing)}; give their folder with --recordings"
        )
    return {name: [read_log(path, RATE_HZ) for path in paths] for name, paths in sets.items()}


def score(name: str, logs: Sequence[xr.Dataset], estimators: Mapping[str, AttitudeEstimator]) -> LogScores:
    """Estimators on a set, from an unknown start."""
    return score_logs(logs, estimators, within_deg=WITHIN_DEG, skip_s=SKIP_S[name])


def vqf_with_defaults() -> AttitudeEstimator:
    """VQF with the parameters of its package in place of the tuned ones."""
    return create("vqf", RATE_HZ, **VQF_DEFAULTS)
