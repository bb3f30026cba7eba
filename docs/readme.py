"""The README's first table."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path

from foreign import PLAN, foreign_cell, foreign_error
from pages import Page, Parts, row
from recordings import BROAD, PHANTOM4, RATE_HZ, recordings, score, vqf_with_defaults
from simulated import estimate_of, simulated

from estimators import create
from estimators.evaluation.comparison import made_of, silenced_twin
from estimators.evaluation.flights import Flights, load_flights
from estimators.evaluation.logs import RAW
from estimators.metrics import attitude_error
from quadsim.estimator import AttitudeEstimator
from scenarios.bench.recommendation import recommendation

WITHOUT_DRAG = ("mahony", "madgwick", "ekf", "eskf", "vqf")
DRAG, MODELS, CHIP, GRU = "ekf-drag", "imm", "att-snn-loihi", "att-rnn"
ALONE = "att-snn-hummingbird"
VEHICLE = "hummingbird"
HEAD = (
    "| roll and pitch from | Hummingbird, simulated [°] | the same, silenced [°] | RotorPy [°] "
    "| BROAD, real [°] | Phantom 4, real [°] |",
    "|---|---|---|---|---|---|",
)


def error_deg(est: AttitudeEstimator, flights: Flights) -> float:
    """Mean absolute error of roll and pitch from an unknown start [deg]."""
    return attitude_error(estimate_of(est, flights), flights.truth).mean


def best(errors: Mapping[str, float]) -> str:
    """The smallest error, and whose it is."""
    name = min(errors, key=errors.__getitem__)
    return f"{errors[name]:.2f} ({name})"


def network_cells(
    name: str,
    own: AttitudeEstimator,
    flights: Flights,
    data: Path,
    errors: Sequence[tuple[float, float]],
) -> list[str]:
    """Errors of a network, silenced beside it; `errors` on the recordings and silenced there."""
    twin = silenced_twin(name)
    assert twin is not None
    real = [f"{error:.2f} (silenced {silent:.2f})" for error, silent in errors]
    rotorpy = foreign_cell(name, lambda _: own, data)
    return [f"{error_deg(own, flights):.2f}", f"{error_deg(twin, flights):.2f}", rotorpy, *real]


def values(page: Page, given: Namespace) -> Parts:
    """Measure."""
    flights = load_flights([simulated("test", given.data)])
    package = {"vqf, package's parameters": vqf_with_defaults()}
    filters = made_of(WITHOUT_DRAG, RATE_HZ) | package
    models = made_of([MODELS], RATE_HZ)[MODELS]
    trained = made_of([CHIP, GRU], RATE_HZ) | {ALONE: create(CHIP, RATE_HZ, weights=ALONE)}
    both = filters | {MODELS: models} | trained
    sets = recordings(given.recordings)
    scores = [score(name, sets[name], both) for name in (BROAD, PHANTOM4)]
    in_simulation = best({name: error_deg(est, flights) for name, est in filters.items()})
    real = [best({name: each.mean(name, RAW) for name in filters}) for each in scores]
    in_rotorpy = best({name: foreign_error(lambda _, e=est: e, given.data) for name, est in filters.items()})
    drag = error_deg(made_of([DRAG], RATE_HZ, vehicle=VEHICLE)[DRAG], flights)
    drag_in_rotorpy = foreign_cell(DRAG, lambda each: create(DRAG, RATE_HZ, vehicle=each), given.data)
    networks = {
        name: network_cells(
            name, est, flights, given.data, [(s.mean(name, RAW), s.silenced(name)) for s in scores]
        )
        for name, est in trained.items()
    }
    rows = {
        "the best filter of one model, without the drag": [in_simulation, "–", in_rotorpy, *real],
        "`imm`, which knows no vehicle": [
            f"{error_deg(models, flights):.2f}",
            "–",
            foreign_cell(MODELS, lambda _: models, given.data),
            *(f"{each.mean(MODELS, RAW):.2f}" for each in scores),
        ],
        "`ekf-drag`, given the vehicle": [f"{drag:.2f}", "–", drag_in_rotorpy, "–", "–"],
        "**Att-SNN on the emulated chip**": networks[CHIP],
        "Att-RNN, its twin of GRUs": networks[GRU],
        "Att-SNN trained for this Hummingbird alone": networks[ALONE],
    }
    return {
        "results": [
            f"**{recommendation().sentence}** This is the result of the held-out suite of flights in closed",
            "loop: four airframes, four IMUs, wind, starts at rest and in motion",
            "([verdict](docs/verdict.md)). Errors outside the loop, on simulated and on real flights:",
            "",
            *HEAD,
            *(row(name, *cells) for name, cells in rows.items()),
            "",
            f"- *Hummingbird*: mean absolute error of roll and pitch over {len(flights.gyro)} simulated "
            f"flights of {flights.gyro.shape[1] / flights.rate_hz:g} s, unknown start.",
            "  Networks were trained and filters tuned in the same simulator, on other flights.",
            f"- *RotorPy*: the same error over {PLAN}, a simulator by other authors.",
            "  Vehicles, aerodynamics, wind and controller are its own, the IMU is our model.",
            "  Nothing was trained or tuned on these flights.",
            f"- *BROAD* ({len(sets[BROAD])} trials by hand) and *Phantom 4* ({len(sets[PHANTOM4])} flights): "
            "inclination RMSE on real recordings, unknown start.",
            "  Nothing was trained or tuned on them ([docs/logs.md](docs/logs.md)).",
        ]
    }
