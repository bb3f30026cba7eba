"""Errors outside the loop, on flights of two simulators and on real recordings.

The recordings are not part of the repository. Their folder holds `broad/` (trials of the BROAD benchmark,
Laidig et al. 2021, CC BY 4.0: hand-moved, 286 Hz, optical truth) and `phantom4/` (flights of a DJI Phantom 4
RTK, Hurwitz & Klein 2023, CC BY 4.0: 120 Hz, truth by the sensor's own filter).
"""

from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from pages import ROOT, Part, Row, Value, Values, number, reduce_colours
from simulated import DESCRIPTION, PLAN, Generated, rotorpy_sets, simulated

from estimators import create
from estimators.circuit.circuit_estimator import Silent
from estimators.evaluation.beliefs import Beliefs, beliefs
from estimators.evaluation.comparison import evaluate, made_of
from estimators.evaluation.flights import load_flights, vehicle_of
from estimators.evaluation.logs import KNOWN, LEVEL, RAW, SILENCED, LogScores, score_logs
from estimators.filters.drag.imm_model import MODELS
from estimators.networks.network import NetworkEstimator
from estimators.registry import parameters
from paper.plan import CHIP, RNN, SNN, sizes_of
from paper.run import write_results
from paper.stages import TUNING, WEIGHTS
from quadsim.estimator import AttitudeEstimator
from quadsim.logs import read_log
from quadsim.vehicle import Vehicle
from scenarios.bench.recommendation import recommendation

Array = NDArray[np.float64]
Made = Mapping[str, AttitudeEstimator]
RATE_HZ = 200.0
HOME, ROTORPY, BROAD, PHANTOM4 = "Hummingbird", "RotorPy", "BROAD", "Phantom 4"
FOLDERS = {BROAD: "broad", PHANTOM4: "phantom4"}
SKIP_S = {BROAD: 3.0, PHANTOM4: 5.0}
"""Time at the start of a recording that is not scored [s]."""
VQF_DEFAULTS = {key: each.default for key, each in parameters("vqf").items() if each.searched}
PACKAGE = "vqf, package's parameters"


def on_flights(
    made: Callable[[Vehicle | None], Made], datasets: Sequence[xr.Dataset], **how: Any
) -> pd.DataFrame:
    """Errors [deg] of estimators, made for an airframe, on datasets together, by estimator and start.

    The mean absolute error of roll and pitch of each flight `sequences`, `mean_deg`, and `silenced_deg` of
    networks. Rotor speeds are kept from all. Without arguments for `evaluate` every start is unknown.
    """
    how = {"initial": ["unknown"], "settle_s": 1.0} | how
    parts = [evaluate(each.drop_vars("rotor_vel"), made(vehicle_of(each)), **how) for each in datasets]
    errors = {key: np.concatenate([part.sequences[key] for part in parts]) for key in parts[0].sequences}
    tables = pd.concat([part.table for part in parts]).groupby(["estimator", "initial"])
    sequences = pd.Series(errors).rename_axis(["estimator", "initial"])
    columns = {"sequences": sequences, "mean_deg": sequences.map(np.mean)}
    return pd.DataFrame({**columns, "silenced_deg": tables["silenced_deg"].mean()})


def with_silenced(found: pd.Series) -> str:
    """An error, of a network with that of the silenced network beside it."""
    text = f"{found.mean_deg:.2f}"
    return text if np.isnan(found.silenced_deg) else f"{text} (silenced {found.silenced_deg:.2f})"


def load_recordings(folder: Path) -> dict[str, list[xr.Dataset]]:
    """The recordings of both sets, resampled to 200 Hz.

    Raises:
        SystemExit: A set is not in the folder.
    """
    sets = {name: sorted((folder / place).glob("*.npz")) for name, place in FOLDERS.items()}
    if missing := [name for name, paths in sets.items() if not paths]:
        raise SystemExit(
            f"{folder}: no recordings of {', '.join(missing)}; give their folder with --recordings"
        )
    return {name: [read_log(path, RATE_HZ) for path in paths] for name, paths in sets.items()}


def on_recordings(made: Made, folder: Path) -> dict[str, LogScores]:
    """Estimators on both sets, from an unknown start."""
    return {
        name: score_logs(logs, made, within_deg=180.0, skip_s=SKIP_S[name])
        for name, logs in load_recordings(folder).items()
    }


def mean_errors(
    made: Callable[[Vehicle | None], Made], flights: Mapping[str, Sequence[xr.Dataset]], folder: Path
) -> pd.DataFrame:
    """Mean error [deg] of estimators, and of one that is always level, on simulated flights and recordings.

    Of an estimator that is made for an airframe only, recordings have no error, NaN.
    """

    def with_level(vehicle: Vehicle | None) -> Made:
        return {**made(vehicle), LEVEL: NetworkEstimator(Silent(), RATE_HZ)}

    columns = {
        name: on_flights(with_level, each).mean_deg.droplevel("initial") for name, each in flights.items()
    }
    for name, scores in on_recordings(made(None), folder).items():
        columns[name] = pd.Series({each: scores.mean(each, RAW) for each in [*made(None), LEVEL]})
    return pd.DataFrame(columns)


def package_vqf() -> Made:
    """VQF with the parameters of its package in place of the tuned ones."""
    return {PACKAGE: create("vqf", RATE_HZ, **VQF_DEFAULTS)}


# --- the README -----------------------------------------------------------------------------------

WITHOUT_DRAG = ("mahony", "madgwick", "ekf", "eskf", "vqf")
ALONE = "att-snn-paper"
ROWS = {
    "best": "best of five filters: `mahony`, `madgwick`, `ekf`, `eskf`, `vqf`",
    "imm": "`imm`, needs no vehicle data",
    "ekf-drag": "`ekf-drag`, given the vehicle's drag",
    "att-snn-loihi": "**Att-SNN on the emulated chip**",
    "att-rnn": "Att-RNN, the same network in floats",
    ALONE: "network of [the paper](docs/paper.md), trained on Hummingbird flights only",
    LEVEL: "always level",
}
COLUMNS = {
    HOME: "Hummingbird, simulated [°]",
    ROTORPY: "RotorPy, simulated [°]",
    BROAD: "BROAD, hand-held, real [°]",
    PHANTOM4: "Phantom 4, real [°]",
}


def readme(part: Part, given: Namespace) -> Values:
    """The README's table of errors."""
    test = simulated("test", given.data)
    flights = {HOME: [test], ROTORPY: rotorpy_sets(given.data)}
    general = made_of([*WITHOUT_DRAG, "imm", "att-snn-loihi", "att-rnn"], RATE_HZ) | package_vqf()
    general[ALONE] = create("att-snn-loihi", RATE_HZ, weights=ALONE)

    def made(vehicle: Vehicle | None) -> Made:
        return general if vehicle is None else general | made_of(["ekf-drag"], RATE_HZ, vehicle=vehicle)

    means = mean_errors(made, flights, given.recordings)
    filters = means.loc[[*WITHOUT_DRAG, PACKAGE]]
    cells = means.map(number)
    cells.loc["best"] = [f"{each.min():.2f} ({each.idxmin()})" for _, each in filters.items()]
    shown = cells.loc[list(ROWS)].rename(ROWS, axis="index").rename(COLUMNS, axis="columns")
    counts = {name: len(logs) for name, logs in load_recordings(given.recordings).items()}
    return {
        "recommendation": recommendation().sentence,
        "errors": shown.reset_index(names="attitude estimator"),
        "flights": str(test.sizes["flight"]),
        "duration": f"{test.sizes['time'] / RATE_HZ:g}",
        "rotorpy": PLAN,
        "broad": str(counts[BROAD]),
        "phantom4": str(counts[PHANTOM4]),
    }


# --- real recordings ------------------------------------------------------------------------------

SCORED = ("imm", "vqf", "eskf", "mahony", "madgwick", "att-snn", "att-rnn")
SETTLED_S = 3.0
"""Time at the start of a simulated flight that is not scored [s]."""
SIMULATED = {
    "hummingbird, hummingbird": Generated("hummingbird", 4, 3),
    "turbulent, hummingbird": Generated("turbulent", 4, 43),
    "robust, hummingbird": Generated("robust", 4, 40),
    "robust, px4-quad": Generated("robust", 4, 41, {"vehicle": "px4-quad"}),
    "robust, crazyflie": Generated("robust", 4, 42, {"vehicle": "crazyflie"}),
}
"""Recipe and vehicle of flights on which nothing is trained."""


def believed(name: str, found: Sequence[tuple[Beliefs, Array, NDArray[np.bool_]]]) -> Row:
    """Mean shares of imm's models, coverage, and σ over error of recordings: beliefs, truth, what counts."""
    shares = np.mean([list(each.share().values()) for each, _, _ in found], axis=0)
    its = [each.interval(truth, counted) for each, truth, counted in found]
    inside = np.mean([each.inside for each in its])
    ratio = np.mean([each.sigma_deg / each.rmse_deg for each in its])
    return name, *(f"{100 * share:.0f} %" for share in (*shares, inside)), f"{ratio:.1f}"


def believed_in_flight(name: str, data: Path) -> Row:
    """The same of simulated flights; those of an earlier run if they are there."""
    flights = load_flights([SIMULATED[name].at(data / f"docs-{name.replace(', ', '-')}.zarr")])
    its = beliefs(create("imm", RATE_HZ), flights.gyro, flights.accel)
    assert its is not None
    counted = np.zeros(flights.truth.shape[:2], np.bool_)
    counted[:, round(SETTLED_S * RATE_HZ) :] = True
    return believed(name, [(its, flights.truth, counted)])


def recordings(part: Part, given: Namespace) -> Values:
    """Errors on real recordings of filters that need no vehicle and of networks, and what imm believes."""
    scores = on_recordings(made_of(SCORED, RATE_HZ) | package_vqf(), given.recordings)
    rows = []
    for name, its in scores.items():
        logs = its.logs.values()
        found = [(log.beliefs["imm"], log.truth[None], log.counted[None]) for log in logs]
        rows.append(believed(f"{name}, real", found))
    values: dict[str, Value] = {
        "models": " | ".join(MODELS),
        "believed": [*rows, *(believed_in_flight(each, given.data) for each in SIMULATED)],
        "vqf": ", ".join(f"{key} {value:g}" for key, value in VQF_DEFAULTS.items()),
    }
    for name, logs in load_recordings(given.recordings).items():
        values |= {
            FOLDERS[name]: [
                (each, *(scores[name].mean(each, kind) for kind in (RAW, SILENCED, KNOWN)))
                for each in scores[name].estimators
            ],
            f"{FOLDERS[name]}_count": str(len(logs)),
            f"{FOLDERS[name]}_s": f"{sum(float(log.attrs['duration_s']) for log in logs):.0f}",
        }
    return values


# --- the paper, rerun -----------------------------------------------------------------------------

NETWORKS = {
    "Att-SNN": ("att-snn", SNN),
    "Att-SNN (Loihi quantisation)": ("att-snn-loihi", CHIP),
    "Att-RNN": ("att-rnn", RNN),
}
FILTERS = ("complementary", "mahony", "madgwick", "ekf")


def paper(part: Part, given: Namespace) -> Values:
    """The page and figures of the run in runs/paper, and the errors of its networks and filters elsewhere."""
    parts = ROOT / "runs" / "paper" / "full"
    write_results(parts, part.path.parent, sizes_of("full"))
    for figure in (part.path.parent / "img").glob("paper-*.png"):
        reduce_colours(figure, 64)
    made = {
        title: create(model, RATE_HZ, weights=parts / stage / WEIGHTS)
        for title, (model, stage) in NETWORKS.items()
    }
    made |= {name: create(name, RATE_HZ, tuning=parts / f"tune-{name}" / TUNING) for name in FILTERS}
    found = mean_errors(lambda _: made, {ROTORPY: rotorpy_sets(given.data)}, given.recordings).loc[
        [*made, LEVEL]
    ]
    return {
        "page": part.path.read_text("utf-8").rstrip("\n"),
        "rotorpy": DESCRIPTION,
        "elsewhere": found.rename({LEVEL: "*always level*"}).reset_index(names="estimator"),
    }
