"""The results of a benchmark, and their tables in a folder."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from pydantic import TypeAdapter, ValidationError
from scipy.special import ndtri

from estimators.registry import COPIES, training_misfit, tuning_misfit
from quadsim.flight.scenario import Scenario
from quadsim.runs.files import replace as replace_file
from quadsim.runs.files import write_csv, write_whole

from .cell import Cell, FlightSettings, tuning_of
from .controllers import CASCADED, controller_of, default_estimators, estimator_of
from .experiment import SUITE, Experiment, Levels
from .flight_metrics import FLIGHT, KEYS, MEASURED, METRICS

Z = float(ndtri(0.975))
"""Half the width of a normal distribution's 95 % interval [standard deviations]."""
FIGURES = {"worst_tilt_deg": "max", "converge_s": "median", "recover_s": "median"}
"""Metrics that include crashed flights; all other metrics are means over flights without a crash."""


@dataclass(frozen=True)
class Results:
    """Results of a benchmark; cells are ordered by scenario, then estimator."""

    scenarios: dict[str, Scenario]
    estimators: list[str]
    settings: FlightSettings
    cells: list[Cell]
    experiment: Experiment = SUITE
    levels: Mapping[str, Levels] = field(default_factory=dict)
    """Levels of each scenario on every axis or sweep; empty without axes."""

    @cached_property
    def flights(self) -> pd.DataFrame:
        """Table with a row per flight and the columns `KEYS` and `FLIGHT`."""
        rows = [
            {"scenario": cell.scenario, "estimator": cell.estimator} | flight
            for cell in self.cells
            for flight in cell.flights
        ]
        return pd.DataFrame(rows, columns=[*KEYS, *FLIGHT]).astype({m.key: float for m in MEASURED})

    @cached_property
    def rows(self) -> list[Any]:
        """A row per cell: reason of a failure, crashes and metrics; None without a value."""
        return records(self._summary({name: name for name in self.scenarios}))

    def _summary(self, level_of: Mapping[str, str]) -> pd.DataFrame:
        """Return a row per contender and level; the column of the level is called "scenario"."""
        own = [cell for cell in self.cells if cell.scenario in level_of]
        cells = [(level_of[cell.scenario], cell.estimator, cell.reason) for cell in own]
        reasons = pd.DataFrame(cells, columns=[*KEYS, "reason"]).groupby(KEYS, sort=False)["reason"]
        levels = self.flights.assign(scenario=self.flights["scenario"].map(level_of.get))
        table = reasons.agg(lambda own: next(filter(None, own), "")).to_frame().join(summarise(levels))
        table["reason"] = table["reason"].where(table["flights"].isna(), "")
        return table.reset_index()

    @property
    def references(self) -> set[str]:
        """Contenders that are given the true attitude.

        If only such contenders flew, with other controllers than the cascade, the controllers are compared
        and there are no references.
        """
        found = {cell.estimator for cell in self.cells if cell.receives_truth}
        compared = found == set(self.estimators) and {*map(controller_of, found)} != {CASCADED}
        return set() if compared else found

    @cached_property
    def unranked(self) -> dict[str, str]:
        """Contenders that are not ranked, with the reason as the end of a sentence after their name.

        Contenders whose flights equal those of another one in every digit are not ranked.
        """
        found = {name: "received the true attitude" for name in sorted(self.references)}
        found |= {name: f"repeats {of}" for name, of in COPIES.items() if {name, of} <= {*self.estimators}}
        found |= {cell.estimator: cell.flaw for cell in self.cells if cell.flaw}
        flown: dict[str, list[Any]] = {}
        for cell in self.cells:
            flown.setdefault(cell.estimator, []).append((cell.reason, cell.flights))
        first: list[str] = []
        for name in (each for each in self.estimators if each not in found):
            twin = next((each for each in first if flown[each] == flown[name]), None)
            if twin:
                found[name] = f"flew exactly as {twin}"
            elif any(flights for _, flights in flown[name]):
                first.append(name)
        return found

    @property
    def warnings(self) -> list[str]:
        """Warnings about tuning or training for another vehicle or IMU, and about faults after the end."""
        tuned: dict[str, dict[str, None]] = {}
        trained: dict[str, dict[str, None]] = {}
        flown_with = dict.fromkeys((each.vehicle, each.imu) for each in self.scenarios.values())
        for (vehicle, imu), name in product(flown_with, self.estimators):
            estimator, airframe = estimator_of(name), Path(vehicle).stem
            if other := tuning_misfit(estimator, tuning_of(name, self.settings.tuning), vehicle, imu):
                text = f"Tuned for {other}, not for the simulated {airframe} with {Path(imu).stem}"
                tuned.setdefault(text, {})[name] = None
            for part in (estimator, controller_of(name)):
                if other := training_misfit(part, vehicle):
                    text = f"Trained on {other}, not on the simulated {airframe}"
                    trained.setdefault(text, {})[part] = None
        how = " Run `quadsim tune` on flights of this vehicle and IMU, and give --set tuning=FILE."
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
        """The missing part of the held-out suite in words.

        The text is empty if nothing is missing, and for other experiments.
        """
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
    def axes(self) -> dict[str, dict[str, list[str]]]:
        """Levels of each axis or sweep in the order of the file, and scenarios at each level.

        Without axes and sweeps, the scenarios are the levels of an axis "scenario".
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
    def by_level(self) -> dict[tuple[str, str, str], Any]:
        """Rows for all flights of a contender at a level, by axis, level and contender."""
        found = {}
        for axis, levels in self.axes.items():
            level_of = {scenario: level for level, own in levels.items() for scenario in own}
            found |= {(axis, row.scenario, row.estimator): row for row in records(self._summary(level_of))}
        return found

    @cached_property
    def totals(self) -> dict[str, Any]:
        """Flights, crashes, failed scenarios and mean metrics of every contender over all scenarios."""
        table = self._summary({name: name for name in self.scenarios})
        names: Any = table.assign(failed=table["reason"] != "").groupby("estimator", sort=False)
        table = names[["flights", "crashes", "failed"]].sum().join(names[[m.key for m in METRICS]].mean())
        table["crash_low"], table["crash_high"] = wilson(table["crashes"], table["flights"])
        return {row.estimator: row for row in records(table.reset_index())}

    def breaking_point(self, sweep: str, name: str) -> str:
        """Return the smallest level of a sweep at which a flight of a contender crashed, in words."""
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
        """CPU time of all flights, including those of earlier runs, in words."""
        count, cpu_s = len(self.flights), sum(cell.cpu_s for cell in self.cells)
        text = f"{count} flight{'s' if count != 1 else ''}"
        text += f", {hours(sum(self.flights['flown_s']))} in the air"
        return f"{text}; {hours(cpu_s)} of processor time" if cpu_s else text


RESULTS = TypeAdapter(Results)
"""Converts results to JSON and back."""


def wilson(hits: ArrayLike, trials: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ends of the 95 % Wilson score interval of shares (Wilson 1927); 0 and 1 without trials."""
    hits, trials = np.asarray(hits, np.float64), np.asarray(trials, np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        share, square = hits / trials, Z * Z / trials
        middle = (share + square / 2) / (1 + square)
        half = Z * np.sqrt(share * (1 - share) / trials + square / (4 * trials)) / (1 + square)
    return np.where(hits > 0, middle - half, 0.0), np.where(hits < trials, middle + half, 1.0)


def summarise(flights: pd.DataFrame) -> pd.DataFrame:
    """Summarise crashes and metrics of each scenario with each estimator; NaN without a value.

    Args:
        flights: Table with a row per flight and the columns `KEYS` and `FLIGHT`.
    """
    every: Any = flights.assign(crashed=flights["cause"] != "").groupby(KEYS, sort=False)
    table = every["crashed"].agg(flights="size", crashes="sum")
    table["crash_rate"] = table["crashes"] / table["flights"]
    table["crash_low"], table["crash_high"] = wilson(table["crashes"], table["flights"])
    never = flights.fillna({"converge_s": np.inf, "recover_s": np.inf})
    counted = {"mean": flights.query("cause == ''"), "max": flights, "median": never}
    for metric in MEASURED:
        figure = FIGURES.get(metric.key, "mean")
        own: Any = counted[figure].groupby(KEYS, sort=False)[metric.key]
        table[metric.key] = own.agg(figure).replace(np.inf, np.nan)
    return table.astype({"flights": "Int64", "crashes": "Int64"})


def records(table: pd.DataFrame) -> list[Any]:
    """Return the rows of a table with columns as attributes; missing values are None."""
    known: Any = table.astype(object).where(table.notna(), None)
    return list(known.itertuples(index=False))


def load_results(out: str | Path) -> Results:
    """Load the results of a benchmark from its folder.

    Raises:
        ValueError: The folder contains no results.
    """
    path = Path(out).expanduser() / "bench.json"
    try:
        return RESULTS.validate_json(path.read_bytes())
    except FileNotFoundError:
        raise ValueError(f"{path.parent}: no benchmark results (there is no bench.json)") from None
    except ValidationError as error:
        raise ValueError(f"{path}: not the results of a benchmark; run it again") from error


def save_results(out: Path, results: Results) -> None:
    """Write the tables, and the file for `load_results`."""
    levels = pd.DataFrame.from_dict(dict(results.levels), orient="index")
    # whose column "scenario" is that of the flights, the name of the combination
    flights = results.flights.join(levels.rename(columns={"scenario": "base scenario"}), on="scenario")
    replace_file(out / "flights.parquet", lambda part: flights.to_parquet(part, index=False))
    write_csv(out / "results.csv", [row._asdict() for row in results.rows])
    write_whole(out / "bench.json", RESULTS.dump_json(results))


def hours(seconds: float) -> str:
    """Format a duration, such as "12 s", "3.4 min" or "6.2 h"."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 6000.0 else f"{seconds / 3600:.1f} h"
