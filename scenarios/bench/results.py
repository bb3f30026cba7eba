"""The results of a benchmark: its flights, their table and index in a folder, and who flew exactly alike."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from pydantic import TypeAdapter, ValidationError

from estimators.registry import COPIES, training_misfit, tuning_misfit
from quadsim.flight.scenario import Scenario
from quadsim.runs.files import replace as replace_file
from quadsim.runs.files import write_csv, write_whole

from .cell import Cell, FlightSettings, tuning_of
from .controllers import CASCADED, controller_of, default_estimators, estimator_of
from .experiment import SUITE, Experiment, Levels
from .flight_metrics import METRICS, CellRow, FlightRow, summarise


@dataclass(frozen=True)
class Results:
    """Results of a benchmark: cells in the order of scenarios, then estimators."""

    scenarios: dict[str, Scenario]
    estimators: list[str]
    settings: FlightSettings
    cells: list[Cell]
    experiment: Experiment = SUITE
    levels: Mapping[str, Levels] = field(default_factory=dict)
    """Of each scenario its level of every axis, or of its sweep; empty without any."""

    @cached_property
    def rows(self) -> list[CellRow]:
        """One row per cell."""
        return [cell.row for cell in self.cells]

    @property
    def references(self) -> set[str]:
        """Contenders that were fed the true attitude, which no vehicle has.

        Where only such ones flew, with other controllers than the cascade, there are none: controllers are
        compared.
        """
        found = {cell.estimator for cell in self.cells if cell.receives_truth}
        compared = found == set(self.estimators) and {*map(controller_of, found)} != {CASCADED}
        return set() if compared else found

    @cached_property
    def unranked(self) -> dict[str, str]:
        """Contenders that are not ranked, and why, to follow their name in a sentence.

        Among them are those whose flights equal another's to the last digit.
        """
        found = {name: "received the true attitude" for name in sorted(self.references)}
        found |= {name: f"repeats {of}" for name, of in COPIES.items() if {name, of} <= {*self.estimators}}
        found |= {cell.estimator: cell.flaw for cell in self.cells if cell.flaw}
        flown: dict[str, list[tuple[str, list[FlightRow]]]] = {}
        for cell in self.cells:
            alike = [replace(flight, estimator="") for flight in cell.flights]
            flown.setdefault(cell.estimator, []).append((cell.reason, alike))
        first: list[str] = []
        for name in (each for each in self.estimators if each not in found):
            twin = next((each for each in first if flown[each] == flown[name]), None)
            if twin:
                found[name] = f"flew exactly as {twin}"
            elif any(flights for _, flights in flown[name]):
                first.append(name)
        return found

    @property
    def planned(self) -> list[tuple[str, int]]:
        """Scenario and seed of every flight that each contender was to fly."""
        return [(name, seed) for name in self.scenarios for seed in range(self.settings.seeds)]

    @property
    def warnings(self) -> list[str]:
        """What was tuned or trained for another vehicle or IMU, and faults that begin after the end."""
        tuned: dict[str, dict[str, None]] = {}
        trained: dict[str, dict[str, None]] = {}
        flown_with = dict.fromkeys((each.vehicle, each.imu) for each in self.scenarios.values())
        for (vehicle, imu), name in product(flown_with, self.estimators):
            estimator, airframe = estimator_of(name), Path(vehicle).stem
            if other := tuning_misfit(estimator, tuning_of(name, self.settings.tuning), vehicle, imu):
                text = f"Tuned for {other}, not for {airframe} with {Path(imu).stem}, which was simulated"
                tuned.setdefault(text, {})[name] = None
            for part in (estimator, controller_of(name)):
                if other := training_misfit(part, vehicle):
                    text = f"Trained on {other}, not on the {airframe}, which was simulated"
                    trained.setdefault(text, {})[part] = None
        how = " `quadsim tune` on flights of it, then --set tuning=FILE."
        late = [
            f"{name} ends at {scenario.duration_s:g} s, before its fault {fault.kind} at {start:g} s"
            for name, scenario in self.scenarios.items()
            for fault in scenario.faults
            if (start := getattr(fault, "at_s", 0.0)) >= scenario.duration_s
        ]
        lines = [f"{text}: {', '.join(who)}.{how}" for text, who in tuned.items()]
        return [*lines, *(f"{text}: {', '.join(who)}." for text, who in trained.items()), *late]

    @property
    def partial(self) -> str:
        """What of the held-out suite is missing, in words; empty if nothing is, or of another experiment."""
        if not self.experiment.held_out:
            return ""
        release, whole = self.experiment.cases(), default_estimators()
        flown = {cell.estimator for cell in self.cells if not cell.reason} & {*whole}
        same = [name for name, case in release.items() if self.scenarios.get(name) == case.scenario]
        counts = {
            "estimators": (len(flown), len(whole)),
            "flights in each scenario": (self.settings.seeds, self.experiment.seeds),
            "scenarios": (len(same), len(release)),
        }
        return ", ".join(f"{n} of its {most} {what}" for what, (n, most) in counts.items() if n < most)

    @cached_property
    def flights(self) -> list[FlightRow]:
        """One row per flight."""
        return [flight for cell in self.cells for flight in cell.flights]

    @cached_property
    def axes(self) -> dict[str, dict[str, list[str]]]:
        """Of each axis, or sweep, its levels in the order of their file, and the scenarios at each.

        Where there is neither, the scenarios are the levels of "scenario".
        """
        found: dict[str, dict[str, list[str]]] = {}
        for name in self.scenarios:
            for axis, level in (self.levels.get(name) or {"scenario": name}).items():
                found.setdefault(axis, {}).setdefault(level, []).append(name)
        order = {axis: list(levels) for axis, levels in self.experiment.axes.items()}
        return {
            axis: {level: levels[level] for level in order.get(axis, levels) if level in levels}
            for axis, levels in found.items()
        }

    @cached_property
    def by_level(self) -> dict[tuple[str, str, str], CellRow]:
        """All flights of a contender at a level, by axis, level and contender."""
        cells = {(cell.scenario, cell.estimator): cell for cell in self.cells}
        found = {}
        for axis, levels in self.axes.items():
            for (level, scenarios), name in product(levels.items(), self.estimators):
                own = [cells[each, name] for each in scenarios]
                flights = [flight for cell in own for flight in cell.flights]
                why = next((cell.reason for cell in own if cell.reason), "")
                found[axis, level, name] = summarise(level, name, "" if flights else why, flights)
        return found

    def breaking_point(self, sweep: str, name: str) -> str:
        """The least level of a sweep at which a flight of a contender crashed, in words."""
        level = ""
        for level in self.axes[sweep]:
            row = self.by_level[sweep, level, name]
            if row.reason:
                return "did not run"
            if row.crashes:
                return level
        return f"> {level}"

    @property
    def cost(self) -> str:
        """What all flights took, those of earlier runs among them, in words."""
        flights, cpu_s = self.flights, sum(cell.cpu_s for cell in self.cells)
        text = f"{len(flights)} flight{'s' if len(flights) != 1 else ''}"
        text += f", {hours(sum(flight.flown_s for flight in flights))} in the air"
        return f"{text}; {hours(cpu_s)} of processor time" if cpu_s else text


RESULTS = TypeAdapter(Results)
"""Writes results as JSON, and reads them."""


class Total(NamedTuple):
    """A contender over all its scenarios."""

    flights: int
    crashes: int
    failed: int  #: scenarios that did not run
    means: Mapping[str, float | None]  #: of each of `METRICS` over scenarios; None where none was measured


def totals_of(rows: Sequence[CellRow]) -> dict[str, Total]:
    """Every contender over all its scenarios, in the order of the rows."""
    found = {}
    for name in dict.fromkeys(row.estimator for row in rows):
        own = [row for row in rows if row.estimator == name]
        flights, crashes = (sum(getattr(r, key) or 0 for r in own) for key in ("flights", "crashes"))
        values = {m.key: [getattr(r, m.key) for r in own if getattr(r, m.key) is not None] for m in METRICS}
        means = {key: float(np.mean(known)) if known else None for key, known in values.items()}
        found[name] = Total(flights, crashes, sum(bool(r.reason) for r in own), means)
    return found


def load_results(out: str | Path) -> Results:
    """The results of an earlier `bench` in its folder.

    Raises:
        ValueError: If there are none.
    """
    path = Path(out).expanduser() / "bench.json"
    try:
        return RESULTS.validate_json(path.read_bytes())
    except FileNotFoundError:
        raise ValueError(f"{path.parent}: no benchmark results (there is no bench.json)") from None
    except ValidationError as error:
        raise ValueError(f"{path}: not the results of a benchmark; run it again") from error


def save_results(out: Path, results: Results) -> None:
    """Write the tables, and what `load_results` reads."""
    flights = [asdict(each) | _columns(results.levels.get(each.scenario, {})) for each in results.flights]
    replace_file(out / "flights.parquet", lambda part: pd.DataFrame(flights).to_parquet(part, index=False))
    write_csv(out / "results.csv", results.rows)
    write_whole(out / "bench.json", RESULTS.dump_json(results))


def _columns(levels: Levels) -> dict[str, str]:
    """Levels as columns of the table, whose column "scenario" has the name of the combination."""
    return {"base scenario" if axis == "scenario" else axis: level for axis, level in levels.items()}


def hours(seconds: float) -> str:
    """A duration: "12 s", "3.4 min", "6.2 h"."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 6000.0 else f"{seconds / 3600:.1f} h"
