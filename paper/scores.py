"""Stages that score: every estimator on recorded flights, recoveries, rates, sizes, and the closed loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimators import create, run
from estimators.evaluation.comparison import evaluate, tilted_starts
from estimators.evaluation.flights import Flights, load_flights
from estimators.metrics import absolute_error, attitude_error, inclination_error
from estimators.networks.weights_file import load_network
from quadsim.dataset.reading import open_dataset
from quadsim.estimator import AttitudeEstimator
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import load_scenario
from scenarios.bench.cell import fly as fly_mission
from scenarios.bench.flight_metrics import Log, flight_metrics

from .work import FLIGHTS, TUNING, WEIGHTS, Inputs, write_numbers

Array = NDArray[np.float64]

FILTERS = ("complementary", "complementary-adaptive", "mahony", "madgwick", "ekf")
SIX = ("complementary", "mahony", "madgwick", "ekf", "att-rnn", "att-snn")
"""The methods of the paper's Table 2."""
SHIPPED = {"att-rnn, shipped": "att-rnn", "att-snn, shipped": "att-snn-loihi"}
TILT_DEG = 20.0
BELOW_DEG = 2.0
"""An estimate that is off by less has found its attitude."""
RESPONSE_S = 15.0
SHOWN_HZ = 20.0
"""Samples a second of the responses that are drawn."""
CLOSED = ("hover", "figure-8", "wind-gust")
"""Scenarios of the closed loop."""
SETTLED_S = 10.0
PARTS = 3
"""The rest of a closed-loop flight is cut into so many equal parts, to see whether the error grows."""


def estimators_of(
    inputs: Inputs, filters: Sequence[str], networks: Mapping[str, Sequence[str]], rate_hz: float = 200.0
) -> dict[str, AttitudeEstimator]:
    """Filters as tuned by their stages; networks (model, stage) with its weights, "" for those that ship."""
    made = {name: create(name, rate_hz, tuning=inputs[f"tune-{name}"] / TUNING) for name in filters}
    for label, (model, stage, *_) in networks.items():
        made[label] = create(model, rate_hz, weights=inputs[stage] / WEIGHTS if stage else None)
    return made


def flights_of(inputs: Inputs, stage: str) -> Flights:
    """The flights of a stage."""
    return load_flights([open_dataset(inputs[stage] / FLIGHTS)])


def error_of(est: AttitudeEstimator, flights: Flights) -> Array:
    """Mean absolute error of each flight from an unknown start, (n,) [deg]."""
    estimate = run(est, flights.gyro, flights.accel, roll_pitch=flights.start, quat=flights.quat)
    return attitude_error(estimate, flights.truth).sequences


def score(
    folder: Path, inputs: Inputs, *, flights: str, networks: Mapping[str, Sequence[str]], settle_s: float,
    seed: int,
) -> None:  # fmt: skip
    """Every method on the flights of one stage, filters also with a known start (Table 2, Fig. 5)."""
    made = estimators_of(inputs, FILTERS, networks)
    done = evaluate(open_dataset(inputs[flights] / FLIGHTS), made, settle_s=settle_s, seed=seed)
    done.write_csv(folder / "evaluation.csv")
    found: dict[str, dict[str, list[float]]] = {}
    for (name, start), errors in done.sequences.items():
        if start == "unknown" or name not in networks:
            found.setdefault(name, {})[start] = errors.tolist()
    write_numbers(folder, {"sequences": found})


def recover(
    folder: Path, inputs: Inputs, *, flights: Sequence[str], hover: str,
    networks: Mapping[str, Sequence[str]], seed: int,
) -> None:  # fmt: skip
    """How estimators find an attitude that they are 20° off (Fig. 6), in two ways.

    In flight: started level where the vehicle is tilted by 20°. In hover: given an initial roll of 20°, which
    filters alone take.
    """
    made = estimators_of(inputs, FILTERS, networks)
    every = round(200.0 / SHOWN_HZ)
    flown = [flights_of(inputs, name) for name in flights]
    steps = min(round(RESPONSE_S * 200), flown[0].gyro.shape[1] // 2)
    parts = [tilted_starts(each, TILT_DEG, steps, seed) for each in flown]
    pieces = [part for part in parts if part is not None]
    still = flights_of(inputs, hover)
    wrong = np.zeros((len(still.gyro), 2))
    wrong[:, 0] = np.radians(TILT_DEG)
    found = {}
    for name, est in made.items():
        errors = np.concatenate(
            [inclination_error(run(est, p.gyro, p.accel, quat=p.quat), p.truth) for p in pieces]
        )
        found[name] = {"flight": response_of(errors, every)}
        if name not in networks:
            estimate = run(est, still.gyro, still.accel, roll_pitch=wrong, quat=still.quat)
            errors = inclination_error(estimate, still.truth)[:, :steps]
            found[name]["hover"] = response_of(errors, every)
    write_numbers(folder, {"starts": sum(len(p.gyro) for p in pieces), "hovers": len(wrong), "found": found})


def response_of(error: Array, every: int) -> dict[str, object]:
    """Inclination errors (n, T) [deg] as they are drawn, and when they are first below `BELOW_DEG` [s]."""
    low, middle, high = np.quantile(error[:, ::every], [0.25, 0.5, 0.75], axis=0)
    below = error < BELOW_DEG
    first = np.where(below.any(axis=1), below.argmax(axis=1) / 200.0, np.inf)
    median = float(np.median(first))
    return {
        "low": low.round(3).tolist(), "median": middle.round(3).tolist(), "high": high.round(3).tolist(),
        "first_s": None if np.isinf(median) else median, "within": float(np.isfinite(first).mean()),
    }  # fmt: skip


def compare(
    folder: Path, inputs: Inputs, *, flights: Sequence[str], filters: Sequence[str],
    networks: Mapping[str, Sequence[str]], rate_hz: float = 200.0,
) -> None:  # fmt: skip
    """Errors of estimators on the flights of some stages: for the pages on rate, size and minutes."""
    made = estimators_of(inputs, filters, networks, rate_hz)
    errors = {
        name: {stage: error_of(est, flights_of(inputs, stage)).tolist() for stage in flights}
        for name, est in made.items()
    }
    sizes = {}
    for label, (_, stage, *_) in networks.items():
        if stage:
            config, tensors = load_network(inputs[stage] / WEIGHTS)
            sizes[label] = [
                config.encoding + config.hidden,
                int(sum(each.size for each in tensors.values())),
            ]
    write_numbers(folder, {"errors": errors, "sizes": sizes})


def close_loop(
    folder: Path, inputs: Inputs, *, networks: Mapping[str, Sequence[str]], seeds: int, duration_s: float,
    seed: int,
) -> None:  # fmt: skip
    """Fly scenarios on this run's network and filters, and see whether the error grows."""
    made = {"truth": create("truth"), **estimators_of(inputs, ("complementary", "mahony", "ekf"), networks)}
    found: dict[str, dict[str, object]] = {}
    for scenario in CLOSED:
        for name, est in made.items():
            mission = Mission(load_scenario(scenario), est, seeds, duration_s=duration_s)
            log, end = fly_mission(mission, seed)
            metrics = flight_metrics(log, end, 200.0, mission.vehicle)
            found.setdefault(scenario, {})[name] = {
                "flights": seeds,
                "crashes": int((mission.cause > 0).sum()),
                "parts_deg": error_in_parts(log, end, 200.0),
                **{
                    key: float(np.nanmean(getattr(metrics, key)))
                    for key in ("error_deg", "attitude_deg", "position_m")
                },
            }
    write_numbers(folder, {"found": found, "duration_s": duration_s})


def error_in_parts(log: Log, end: NDArray[np.int64], rate_hz: float) -> list[float]:
    """Mean absolute error in equal parts of the flights that lasted, after they have settled [deg]."""
    first = min(round(SETTLED_S * rate_hz), log.shape[1] // 2)
    late = log[end == log.shape[1], first:]
    error = absolute_error(late["estimate"], late["euler"][..., :2])
    return [float(part.mean()) if part.size else np.nan for part in np.array_split(error, PARTS, axis=1)]


def latencies(folder: Path, inputs: Inputs, *, rounds: int) -> None:
    """Time of one update of every estimator (Fig. 9), in turns."""
    from estimators.analysis.latency import contenders, measure

    taken = measure(contenders(), rounds)
    found = {name: [float(x) for x in np.percentile(each, [1, 50, 99])] for name, each in taken.items()}
    write_numbers(folder, {"µs": found, "calls": min(each.size for each in taken.values())})


def look_inside(folder: Path, inputs: Inputs, *, flights: str, network: str, rnn: str) -> None:
    """Spikes, ablation, manipulated inputs and operations of a network (Figs. 7, 8, 9, FLOPs)."""
    from estimators.analysis.energy import gru_flops, snn_flops
    from estimators.analysis.inspection import FRACTIONS, inspect

    config, tensors = load_network(inputs[network] / WEIGHTS)
    flown = flights_of(inputs, flights)
    found = inspect(network, config, tensors, flown)
    spikes = (float(found.layer_rates(0).sum()), float(found.layer_rates(1).sum()))
    twin, _ = load_network(inputs[rnn] / WEIGHTS)
    shown = round(25.0 * flown.rate_hz)
    write_numbers(
        folder,
        {
            "rates": [found.layer_rates(k).round(5).tolist() for k in (0, 1)],
            "silent": list(found.silent),
            "fractions": list(FRACTIONS),
            "ablation": {by: errors.tolist() for by, errors in found.ablation.items()},
            "responses": {
                name: {
                    "error_deg": each.error_deg,
                    "gain": each.gain,
                    "slow_gain": each.slow_gain,
                    "fast_gain": each.fast_gain,
                    "roll_deg": np.degrees(each.estimate[:shown:4, 0]).round(2).tolist(),
                }
                for name, each in found.responses.items()
            },
            "roll_deg": np.degrees(found.truth[:shown:4, 0]).round(2).tolist(),
            "step_s": 4 / flown.rate_hz,
            "costs": [asdict(each) for each in found.costs],
            "flops": snn_flops(config.encoding, config.hidden, spikes)
            | {"gru": gru_flops(twin.encoding, twin.hidden)},
            "spikes": spikes,
        },
    )
