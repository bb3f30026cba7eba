"""The README's table of errors."""

from argparse import Namespace
from collections.abc import Mapping, Sequence

from foreign import PLAN, foreign_error
from pages import Part, Values, row
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
DRAG, MODELS, CHIP, FLOATS = "ekf-drag", "imm", "att-snn-loihi", "att-rnn"
ALONE = "att-snn-paper"
VEHICLE = "hummingbird"


def error_deg(est: AttitudeEstimator, flights: Flights) -> float:
    """Mean absolute error of roll and pitch from an unknown start [deg]."""
    return attitude_error(estimate_of(est, flights), flights.truth).mean


def best(errors: Mapping[str, float]) -> str:
    """The smallest error, and whose it is."""
    name = min(errors, key=errors.__getitem__)
    return f"{errors[name]:.2f} ({name})"


def values(part: Part, given: Namespace) -> Values:
    """Measure."""
    flights = load_flights([simulated("test", given.data)])
    package = {"vqf, package's parameters": vqf_with_defaults()}
    filters = made_of(WITHOUT_DRAG, RATE_HZ) | package
    models = made_of([MODELS], RATE_HZ)[MODELS]
    trained = made_of([CHIP, FLOATS], RATE_HZ) | {ALONE: create(CHIP, RATE_HZ, weights=ALONE)}
    both = filters | {MODELS: models} | trained
    sets = recordings(given.recordings)
    scores = [score(name, sets[name], both) for name in (BROAD, PHANTOM4)]
    in_simulation = best({name: error_deg(est, flights) for name, est in filters.items()})
    real = [best({name: each.mean(name, RAW) for name in filters}) for each in scores]
    in_rotorpy = best({name: foreign_error(lambda _, e=est: e, given.data) for name, est in filters.items()})
    drag = error_deg(made_of([DRAG], RATE_HZ, vehicle=VEHICLE)[DRAG], flights)
    drag_in_rotorpy = foreign_error(lambda each: create(DRAG, RATE_HZ, vehicle=each), given.data)
    level = silenced_twin(CHIP)
    assert level is not None

    def errors(est: AttitudeEstimator, real: Sequence[float]) -> list[str]:
        simulated_errors = (error_deg(est, flights), foreign_error(lambda _: est, given.data))
        return [f"{error:.2f}" for error in (*simulated_errors, *real)]

    def row_of(name: str) -> list[str]:
        return errors(both[name], [each.mean(name, RAW) for each in scores])

    rows = {
        "best of `mahony`, `madgwick`, `ekf`, `eskf` and `vqf`": [in_simulation, in_rotorpy, *real],
        "`imm`, needs no data of the vehicle": row_of(MODELS),
        "`ekf-drag`, given the vehicle's drag": [f"{drag:.2f}", f"{drag_in_rotorpy:.2f}", "–", "–"],
        "**Att-SNN on the emulated chip**": row_of(CHIP),
        "Att-RNN, the same network in floats": row_of(FLOATS),
        "the paper's network, trained for this Hummingbird only": row_of(ALONE),
        "always level": errors(level, [each.silenced(CHIP) for each in scores]),
    }
    return {
        "recommendation": recommendation().sentence,
        "rows": [row(name, *cells) for name, cells in rows.items()],
        "flights": str(len(flights.gyro)),
        "duration": f"{flights.gyro.shape[1] / flights.rate_hz:g}",
        "rotorpy": PLAN,
        "broad": str(len(sets[BROAD])),
        "phantom4": str(len(sets[PHANTOM4])),
    }
