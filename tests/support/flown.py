"""Results with flights that are made up, and flights in time as the report unpacks them."""

import base64

import numpy as np
import pandas as pd

from quadsim.flight.faults import Bias
from quadsim.flight.scenario import Scenario
from quadsim.wind import Constant
from scenarios.bench.cell import Cell, FlightSettings
from scenarios.bench.experiment import SUITE
from scenarios.bench.flight_metrics import FLIGHT
from scenarios.bench.flight_series import MISSING
from scenarios.bench.results import Results

WHOLE_S = 20.0
WINDY = Scenario(
    description="",
    duration_s=2.0,
    wind=(Constant(kind="constant", velocity=(3.0, 1.0, 0.0)),),
    faults=(Bias(kind="bias", gyro_deg=(3.0, -2.0, 0.0), at_s=1.0),),
)


def crash(at_s, error=0.1):
    """A flight that crashes, with a small error until then."""
    return at_s, error


def flight(seed, outcome):
    at_s, error = outcome if isinstance(outcome, tuple) else (None, outcome)
    numbers = {"error_deg": error, "attitude_deg": 2 * error, "jitter": 5.0, "flown_s": at_s or WHOLE_S}
    return dict.fromkeys(FLIGHT) | numbers | {"seed": seed, "cause": "tilted over" * (at_s is not None)}


def table(*flights):
    """Flights as (scenario, estimator, seed, outcome)."""
    return pd.DataFrame([{"scenario": s, "estimator": e} | flight(*each) for s, e, *each in flights])


def benchmark(outcomes, references=("truth",), flaws=None, scenarios=None, experiment=SUITE, levels=None):
    """Results with these flights: {contender: {scenario: [error or crash(...) of each seed, or why not]}}."""
    names = list(dict.fromkeys(scenario for each in outcomes.values() for scenario in each))
    cells, seeds = [], 1
    for scenario in names:
        for name, own in outcomes.items():
            if isinstance(flown := own[scenario], str):
                cells.append(Cell(scenario, name, flown))
                continue
            seeds = len(flown)
            flights = [flight(seed, each) for seed, each in enumerate(flown)]
            reference = name.split(" @ ")[0] in references
            flaw = (flaws or {}).get(name, "")
            cells.append(Cell(scenario, name, flights=flights, receives_truth=reference, flaw=flaw))
    known = scenarios or {name: Scenario(description="") for name in names}
    return Results(known, list(outcomes), FlightSettings(seeds), cells, experiment, levels or {})


def unpack_series(series):
    """Every channel and signal of a flight, each (T,), NaN where missing, and its `time` [s]."""
    found = {}
    for name, channel in series.channels.items():
        integers = np.frombuffer(base64.b64decode(channel.data), "<i2")
        found[name] = np.where(integers == MISSING, np.nan, channel.scale * integers.astype(np.float64))
    return found | {"time": series.dt * np.arange(len(found["x"]), dtype=np.float64)}
