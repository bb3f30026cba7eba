"""Stages that score networks over folds, estimators on recorded flights, recoveries, and closed loops."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators import create, run
from estimators.analysis.latency import timed_estimators, update_times
from estimators.evaluation.comparison import evaluate, tilted_starts
from estimators.evaluation.flights import Flights, load_flights
from estimators.metrics import absolute_error, attitude_error, inclination_error
from estimators.networks.network import create_network
from quadsim.dataset.reading import open_dataset
from quadsim.estimator import AttitudeEstimator
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import load_scenario
from scenarios.bench.flight_log import Log, fly_mission
from scenarios.bench.flight_metrics import flight_metrics
from training.config import TrainConfig
from training.data import load_training_flights
from training.data import split_flights as training_flights_of

from ..stages import FLIGHTS, TUNING, WEIGHTS, Numbers

Array = NDArray[np.float64]
Tuned = Mapping[str, Path]
"""Folder of the tuning, by filter."""
Networks = Mapping[str, tuple[str, Path]]
"""Model and folder of the weights, by label."""

SIX = ("att-snn", "att-rnn", "madgwick", "mahony", "complementary", "ekf")
"""The methods of the paper's Table 2."""
FILTERS = ("complementary", "complementary-adaptive", "mahony", "madgwick", "ekf")
TILT_DEG = 20.0
CONVERGED_DEG = 2.0
"""Inclination error below which an estimator counts as converged [deg]."""
RESPONSE_S = 15.0
RATE_HZ = 200.0
SHOWN_HZ = 20.0
"""Sample rate of the drawn responses [Hz]."""
CLOSED = ("hover", "figure-8", "wind-gust")
"""Scenarios of the closed loop."""
SETTLED_S = 10.0
PARTS = 3
"""Number of equal parts of a settled closed-loop flight, to see whether the error grows."""


def estimators_of(
    filters: Tuned, networks: Networks, rate_hz: float = RATE_HZ
) -> dict[str, AttitudeEstimator]:
    """Make filters, as tuned by their stages, and networks."""
    tuned = {name: create(name, rate_hz, tuning=path / TUNING) for name, path in filters.items()}
    return tuned | {
        label: create(model, rate_hz, weights=path / WEIGHTS) for label, (model, path) in networks.items()
    }


def stage_flights(path: Path) -> Flights:
    """Load the flights of a stage."""
    return load_flights([open_dataset(path / FLIGHTS)])


def score_folds(
    folder: Path, *, domains: Sequence[Path], mixed: Sequence[Path], only: Sequence[Path]
) -> Numbers:
    """Score networks on training and test flights, of both domains mixed and of one domain (Table 1).

    Args:
        folder: Folder of the stage.
        domains: Flights of both domains.
        mixed: Networks by draw of the 70/20/10 split.
        only: Networks trained on one domain and tested on the other.
    """
    first, second = domains
    cases = [(path, domains, None) for path in mixed]
    cases += [(only[0], [first], second), (only[1], [second], first)]
    found = {}
    for path, own, other in cases:
        config = TrainConfig.model_validate_json((path / "config.json").read_text("utf-8"))
        data = tuple(str(each / FLIGHTS) for each in own)
        train, _, test = training_flights_of(config.model_copy(update={"data": data}))
        test = load_training_flights([other / FLIGHTS]) if other else test
        network = create_network(config.model, train.rate_hz, weights=path / WEIGHTS)
        found[path.name] = {}
        for name, flights in (("train", train), ("test", test)):
            network.reset(len(flights))
            error = attitude_error(network.sequence(flights.gyro, flights.accel), flights.roll_pitch)
            found[path.name][name] = error.sequences.tolist()
    return found


def score(folder: Path, *, flights: Path, filters: Tuned, networks: Networks, seed: int) -> Numbers:
    """Score every method on flights, filters also with a known start (Table 2, Fig. 5 and others)."""
    recorded = open_dataset(flights / FLIGHTS)
    made = estimators_of(filters, networks, float(recorded.attrs["rate_hz"]))
    done = evaluate(recorded, made, settle_s=10.0, seed=seed)
    done.write_csv(folder / "evaluation.csv")
    sequences: dict[str, dict[str, list[float]]] = {name: {} for name in made}
    for (name, start), errors in done.sequences.items():
        if start == "unknown" or name in FILTERS:
            sequences[name][start] = errors.tolist()
    silenced = {row.estimator: row.silenced_deg for row in done.rows if np.isfinite(row.silenced_deg)}
    return {"sequences": sequences, "silenced_deg": silenced}


def recover(
    folder: Path, *, flying: Sequence[Path], hover: Path, filters: Tuned, networks: Networks, seed: int
) -> Numbers:
    """Measure the convergence of estimators from an error of 20° (Fig. 6), in two ways.

    In flight, estimators start at level while the vehicle is tilted by 20°. In hover, filters are given an
    initial roll of 20°; networks accept no initial attitude. The example is a start with a pitch of 20°, on
    the second domain.
    """
    flights, still = [stage_flights(each) for each in flying], stage_flights(hover)
    steps = min(round(RESPONSE_S * RATE_HZ), flights[0].gyro.shape[1] // 2)
    starts = [tilted_starts(each, TILT_DEG, steps, seed) for each in flights]
    pieces = [piece for piece in starts if piece is not None]
    pitched = int(np.argmax(np.abs(pieces[-1].truth[:, 0, 1])))
    wrong = np.zeros((len(still.gyro), 2))
    wrong[:, 0] = np.radians(TILT_DEG)
    curves, example = {}, {"truth": shown_pitch(pieces[-1].truth[pitched])}
    for name, est in estimators_of(filters, networks).items():
        estimates = [run(est, piece.gyro, piece.accel, quat=piece.quat) for piece in pieces]
        errors = [inclination_error(each, p.truth) for each, p in zip(estimates, pieces, strict=True)]
        curves[name] = {"flight": response_of(np.concatenate(errors))}
        example[name] = shown_pitch(estimates[-1][pitched])
        if name in FILTERS:
            estimate = run(est, still.gyro, still.accel, roll_pitch=wrong, quat=still.quat)
            curves[name]["hover"] = response_of(inclination_error(estimate, still.truth)[:, :steps])
    count = sum(len(piece.gyro) for piece in pieces)
    return {"starts": count, "hovers": len(wrong), "curves": curves, "example": example}


def shown_pitch(estimate: Array) -> list[float]:
    """Return the pitch of one flight (T, 2) for drawing [deg]."""
    return np.degrees(estimate[:: round(RATE_HZ / SHOWN_HZ), 1]).round(2).tolist()


def response_of(error: Array) -> dict[str, object]:
    """Return the median of inclination errors (n, T) for drawing [deg], and times to converge [s].

    The time is None if an estimator never converges.
    """
    below = error < CONVERGED_DEG
    first = np.where(below.any(axis=1), below.argmax(axis=1) / RATE_HZ, np.inf)
    return {
        "median": np.median(error[:, :: round(RATE_HZ / SHOWN_HZ)], axis=0).round(3).tolist(),
        "times_s": [None if np.isinf(time) else float(time) for time in first],
    }


def close_loop(
    folder: Path, *, filters: Tuned, networks: Networks, seeds: int, duration_s: float, seed: int
) -> Numbers:
    """Simulate scenarios with networks and filters in the loop, and measure whether the error grows."""
    made = {"truth": create("truth"), **estimators_of(filters, networks)}
    scenarios: dict[str, dict[str, dict[str, Any]]] = {name: {} for name in CLOSED}
    for scenario, scores in scenarios.items():
        for name, est in made.items():
            mission = Mission(load_scenario(scenario), est, seeds, duration_s=duration_s)
            log, end, _ = fly_mission(mission, seed)
            metrics = flight_metrics(log, end, RATE_HZ, mission.vehicle)
            scores[name] = {
                "flights": seeds,
                "crashes": int((mission.cause > 0).sum()),
                "parts_deg": error_in_parts(log, end),
            }
            for key in ("error_deg", "attitude_deg", "position_m"):
                scores[name][key] = float(np.nanmean(metrics[key]))
    return {"scenarios": scenarios, "duration_s": duration_s}


def error_in_parts(log: Log, end: NDArray[np.int64]) -> list[float]:
    """Return the mean absolute error in equal parts of the settled flights without a crash [deg]."""
    first = min(round(SETTLED_S * RATE_HZ), log.shape[1] // 2)
    settled = log[end == log.shape[1], first:]
    error = absolute_error(settled["estimate"], settled["euler"][..., :2])
    return [float(part.mean()) if part.size else np.nan for part in np.array_split(error, PARTS, axis=1)]


def latencies(folder: Path, *, rounds: int) -> Numbers:
    """Measure the time of one update of every estimator (Fig. 9): 1st, 50th and 99th percentile [µs]."""
    taken = update_times(timed_estimators(), rounds)
    return {name: np.percentile(each, [1, 50, 99]).tolist() for name, each in taken.items()}
