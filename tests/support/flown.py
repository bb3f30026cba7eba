"""Results with flights that are made up."""

from dataclasses import fields

from quadsim.flight.scenario import Scenario
from scenarios.bench.cell import Cell, FlightSettings, failed_cell
from scenarios.bench.experiment import SUITE
from scenarios.bench.flight_metrics import FlightMetrics, FlightRow
from scenarios.bench.results import Results

WHOLE_S = 20.0


def crash(at_s, error=0.1):
    """A flight that crashes, with a small error until then."""
    return at_s, error


def flight(scenario, name, seed, outcome):
    """An error, or a crash."""
    at_s, error = outcome if isinstance(outcome, tuple) else (None, outcome)
    numbers = dict.fromkeys(each.name for each in fields(FlightMetrics))
    numbers |= {"error_deg": error, "attitude_deg": 2 * error, "jitter": 5.0}
    return FlightRow(scenario, name, seed, "tilted over" * (at_s is not None), at_s or WHOLE_S, **numbers)


def benchmark(outcomes, references=("truth",), flaws=None, scenarios=None, experiment=SUITE, levels=None):
    """Results with these flights: {contender: {scenario: [error or crash(...) of each seed, or why not]}}."""
    names = list(dict.fromkeys(scenario for each in outcomes.values() for scenario in each))
    cells, seeds = [], 1
    for scenario in names:
        for name, own in outcomes.items():
            if isinstance(flown := own[scenario], str):
                cells.append(failed_cell(scenario, name, flown))
                continue
            seeds = len(flown)
            flights = [flight(scenario, name, seed, each) for seed, each in enumerate(flown)]
            reference = name.split(" @ ")[0] in references
            flaw = (flaws or {}).get(name, "")
            cells.append(Cell(scenario, name, "", flights, [], None, reference, flaw))
    known = scenarios or {name: Scenario(description="") for name in names}
    return Results(known, list(outcomes), FlightSettings(seeds), cells, experiment, levels or {})
