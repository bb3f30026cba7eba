"""A hover of a second, with faults if wanted, simulated with the true attitude."""

from quadsim.flight.mission import Mission
from quadsim.flight.scenario import Scenario, Start
from quadsim.seeding import vehicle_seeds

HOVER = Scenario(description="", duration_s=1.0, start=Start(known_attitude=True))


def with_faults(*faults: dict) -> Scenario:
    return Scenario.model_validate(HOVER.model_dump() | {"faults": faults})


def flown(scenario: Scenario, n: int = 2, seed: int = 0) -> Mission:
    mission = Mission(scenario, None, n)
    mission.begin(vehicle_seeds(seed, n))
    for _ in range(mission.steps):
        mission.step()
    return mission
