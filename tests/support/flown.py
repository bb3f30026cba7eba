"""Results with flights that are made up."""

import pandas as pd

from quadsim.flight.scenario import Scenario
from scenarios.bench.cell import Cell, FlightSettings
from scenarios.bench.experiment import SUITE
from scenarios.bench.flight_metrics import FLIGHT
from scenarios.bench.results import Results

WHOLE_S = 20.0


def crash(at_s, error=0.1):
    """A flight that crashes, with a small error until then."""
    return at_s, error


def flight(seed, outcome):
    """A flight of a cell with an error, or a crash."""
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
