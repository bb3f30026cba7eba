"""The closed-loop benchmark: scenarios × estimators × seeds, resumable, the same on any number of workers."""

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from itertools import product
from pathlib import Path

import estimators
from estimators.control.controller import create_controller, is_controller
from estimators.registry import training_misfit, tuning_misfit
from estimators.tuned import load_tuning
from quadsim.external import load_external
from quadsim.flight.scenario import Scenario, load_scenario
from quadsim.imu.spec import load_imu
from quadsim.own import own_files
from quadsim.runs.files import alone, drop_parts, read_json, write_csv, write_json
from quadsim.runs.fingerprint import ROOT, code_digest, file_digest, fingerprint
from quadsim.runs.pool import run_all
from quadsim.vehicle import load_vehicle

from .cell import (
    CELL,
    Cell,
    digest_if_there,
    failed_cell,
    file_name,
    fly_cell,
    load_cell,
    tuning_of,
    weights_digest,
)
from .controllers import CASCADED, controller_of, estimator_of, make_controller
from .flight_metrics import CellRow, FlightRow
from .settings import FlightSettings, ScenarioChanges

log = logging.getLogger(__name__)

Progress = Callable[[int, int], None]
NO_CHANGES = ScenarioChanges()


@dataclass(frozen=True)
class Results:
    """Results of a benchmark: cells in the order of scenarios, then estimators."""

    scenarios: dict[str, Scenario]
    estimators: list[str]
    settings: FlightSettings
    cells: list[Cell]

    @property
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

    @property
    def unranked(self) -> dict[str, str]:
        """Contenders that are not ranked, and why, to follow their name in a sentence."""
        flaws = {cell.estimator: cell.flaw for cell in self.cells if cell.flaw}
        return {name: "received the true attitude" for name in sorted(self.references)} | flaws

    @property
    def planned(self) -> list[tuple[str, int]]:
        """Scenario and seed of every flight that each contender was to fly."""
        return [(name, seed) for name in self.scenarios for seed in range(self.settings.seeds)]

    @property
    def warnings(self) -> list[str]:
        """Estimators and controllers that were tuned or trained for another vehicle or IMU than flew."""
        return [*self._tuned_elsewhere, *self._trained_elsewhere]

    @property
    def _trained_elsewhere(self) -> list[str]:
        parts = [each for name in self.estimators for each in (estimator_of(name), controller_of(name))]
        found: dict[str, dict[str, None]] = {}
        for vehicle, part in product(dict.fromkeys(s.vehicle for s in self.scenarios.values()), parts):
            if trained := training_misfit(part, vehicle):
                text = f"on {trained}, not on the {Path(vehicle).stem}, which was simulated"
                found.setdefault(text, {})[part] = None
        return [f"Trained {text}: {', '.join(who)}." for text, who in found.items()]

    @property
    def _tuned_elsewhere(self) -> list[str]:
        tuning, found = self.settings.tuning, dict[str, dict[str, None]]()
        simulated_with = dict.fromkeys((s.vehicle, s.imu) for s in self.scenarios.values())
        for (vehicle, imu), name in product(simulated_with, self.estimators):
            if other := tuning_misfit(estimator_of(name), tuning_of(name, tuning), vehicle, imu):
                simulated = f"{Path(vehicle).stem} with {Path(imu).stem}"
                found.setdefault(f"for {other}, not for {simulated}, which was simulated", {})[name] = None
        return [
            f"Tuned {text}: {', '.join(who)}. `quadsim tune` on its flights, then --set tuning=FILE."
            for text, who in found.items()
        ]

    @property
    def flights(self) -> list[FlightRow]:
        """One row per flight."""
        return [flight for cell in self.cells for flight in cell.flights]


def bench(
    scenarios: Sequence[str | Path] | Mapping[str, Scenario],
    names: Sequence[str],
    out: str | Path,
    settings: FlightSettings,
    changes: ScenarioChanges = NO_CHANGES,
    *,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Results:
    """Fly every scenario with every estimator and the same seeds; write `results.csv` and `flights.csv`.

    The results do not depend on the number of workers. Every finished cell is stored under `out/cells`; a
    later run with the same scenario, estimator, seeds and code reads it. Worker processes import the caller's
    main module, so a script calls this under `if __name__ == "__main__":`.

    Args:
        scenarios: Names of shipped scenarios or paths of TOML files; or scenarios by their names.
        names: Names of estimators, or paths of weights.
        out: Folder for the results.
        settings: Seeds, sample rate, tuning.
        changes: Fields that replace those of every scenario.
        workers: Processes, by default one for each CPU; 1 stays in this process.
        executor: Where to run in place of processes of our own, for instance a Dask client's
            `get_executor()`.
        progress: Called with the cells done and their total at the start and after each cell.

    Raises:
        ValueError: For a bad argument or scenario file, or a folder that another process writes.
        OSError: If the results cannot be written.
    """
    loaded, names = _load(scenarios, names, settings, changes), list(dict.fromkeys(names))
    out = Path(out).expanduser()
    with alone(out):
        out.mkdir(parents=True, exist_ok=True)
        drop_parts(out)
        code = suite_digest()
        pairs = [(s, e) for s in loaded for e in names]
        prints = {(s, e): _fingerprint(loaded[s], e, settings, code) for s, e in pairs}
        stored = {pair: load_cell(cell_path(out, *pair)) for pair in pairs}
        cells = {pair: cell for pair, cell in stored.items() if cell and cell.fingerprint == prints[pair]}
        missing = [pair for pair in pairs if pair not in cells]
        if progress:
            progress(len(cells), len(pairs))
        jobs = [(s, loaded[s], e, settings, prints[s, e]) for s, e in missing]
        said: set[tuple[str, str]] = set()
        for i, cell in run_all(fly_cell, jobs, workers, executor):
            if isinstance(cell, BaseException):  # the worker itself died
                cell = failed_cell(*missing[i], prints[missing[i]], f"{type(cell).__name__}: {cell}")
            cells[missing[i]] = cell
            if cell.reason:
                if (cell.estimator, cell.reason) not in said:
                    log.warning("%s with %s did not run: %s", cell.scenario, cell.estimator, cell.reason)
                said.add((cell.estimator, cell.reason))  # other scenarios with the same reason are not listed
            else:
                write_json(cell_path(out, cell.scenario, cell.estimator), asdict(cell))
            if progress:
                progress(len(cells), len(pairs))
        results = Results(loaded, names, settings, [cells[pair] for pair in pairs])
        write_csv(out / "results.csv", results.rows)
        write_csv(out / "flights.csv", results.flights)
        _save_index(out, results)
        return results


def identical(results: Results) -> dict[str, str]:
    """Estimators whose flights equal those of one before them to the last digit, and which one.

    A reference stands for no estimator; what did not run failed for the same reason.
    """
    references = results.references
    flown: dict[str, list[FlightRow]] = {name: [] for name in results.estimators if name not in references}
    for flight in results.flights:
        if flight.estimator not in references:
            flown[flight.estimator].append(replace(flight, estimator=""))
    reasons = {name: tuple(cell.reason for cell in results.cells if cell.estimator == name) for name in flown}
    first: dict[tuple[object, ...], str] = {}
    found = {}
    for name, flights in flown.items():
        if flights and (earlier := first.setdefault((*flights, reasons[name]), name)) != name:
            found[name] = earlier
    return found


def shown_once(results: Results) -> tuple[Results, str]:
    """Results without the estimators that flew exactly as another, and a line that names them."""
    same = identical(results)
    kept = replace(
        results,
        estimators=[name for name in results.estimators if name not in same],
        cells=[cell for cell in results.cells if cell.estimator not in same],
    )
    said = "; ".join(f"{name} flew exactly as {other}" for name, other in same.items())
    return kept, f"{said}: shown once." if same else ""


def load_results(out: str | Path) -> Results:
    """The results of an earlier `bench` in its folder.

    Raises:
        ValueError: If there are none, or not all of them.
    """
    out = Path(out).expanduser()
    try:
        index = read_json(out / "bench.json")
        settings = dict(index["settings"])
        scenarios, names = settings.pop("scenarios"), settings.pop("estimators")
        scenarios = {name: Scenario.model_validate_json(json.dumps(s)) for name, s in scenarios.items()}
        settings = FlightSettings(**settings)
        failed = {(f["scenario"], f["estimator"]): CELL.validate_python(f) for f in index["failed"]}
        fingerprints = {(s, e): print_ for s, e, print_ in index["fingerprints"]}
    except FileNotFoundError:
        raise ValueError(f"{out}: no benchmark results (there is no bench.json)") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{out / 'bench.json'}: not the index of a benchmark: {error}") from error
    cells = []
    for pair in [(s, e) for s in scenarios for e in names]:
        cell = failed.get(pair) or load_cell(cell_path(out, *pair))
        if cell is None or cell.fingerprint != fingerprints.get(pair):
            wrong = "of another run than the rest" if cell else "missing or damaged"
            raise ValueError(f"{cell_path(out, *pair)}: {wrong}; run the benchmark again")
        cells.append(cell)
    return Results(scenarios, names, settings, cells)


def cell_path(out: Path, scenario: str, estimator: str) -> Path:
    """File of a cell."""
    return out / "cells" / f"{scenario}--{file_name(estimator)}.json"


def _files_of(scenario: Scenario) -> list[str | Path]:
    """What a scenario reads besides presets: set-points, a user's function, wind."""
    found: list[str | Path] = [
        part.path for part in (scenario.trajectory, *scenario.wind) if part.kind == "file"
    ]
    if scenario.trajectory.kind == "function":
        found += own_files(scenario.trajectory.function)
    return found


def suite_digest() -> str:
    """Digest of the code and data that a cell's numbers come from: change these, and cells run again."""
    files = [path for path in (ROOT / "assets").rglob("*.*") if "__pycache__" not in path.parts]
    assets = {path.relative_to(ROOT).as_posix(): file_digest(path) for path in files}
    return fingerprint(code_digest("scenarios.bench.cell", "estimators"), assets)


def _load(
    scenarios: Sequence[str | Path] | Mapping[str, Scenario],
    names: Sequence[str],
    settings: FlightSettings,
    changes: ScenarioChanges,
) -> dict[str, Scenario]:
    """The scenarios by name, everything that a user may have mistyped checked before the first flight."""
    loaded: dict[str, Scenario] = {}
    for source in scenarios:
        given = scenarios[str(source)] if isinstance(scenarios, Mapping) else load_scenario(source)
        scenario, name = changes.of(given), Path(source).name.removesuffix(".toml")
        if name in loaded:
            raise ValueError(f'two scenarios are called "{name}"; give one of the files another name')
        load_vehicle(scenario.vehicle)
        load_imu(scenario.imu)
        load_external(scenario.external)
        loaded[name] = scenario
    if settings.tuning is not None and not set(map(estimator_of, names)) & set(load_tuning(settings.tuning)):
        raise ValueError(f"{settings.tuning}: it has no table of {', '.join(names)}")
    for name in dict.fromkeys(map(estimator_of, names)):
        if name not in estimators.names():
            estimators.create(name, settings.rate_hz)  # raises: the valid ones, or what is wrong with weights
    check_controllers(names, settings.rate_hz)
    if not loaded or not names:
        raise ValueError(f"nothing to fly: give at least one {'estimator' if loaded else 'scenario'}")
    return loaded


def check_controllers(names: Sequence[str], rate_hz: float) -> None:
    """Whether the controllers of contenders can be made.

    Raises:
        FileNotFoundError: No such weights.
        ValueError: No such controller, or weights of something else or another rate.
    """
    for name in dict.fromkeys(map(controller_of, names)):
        make_controller(name)
        if is_controller(name):
            create_controller(name, rate_hz)


def _fingerprint(scenario: Scenario, estimator: str, settings: FlightSettings, code: str) -> str:
    tuning = tuning_of(estimator, settings.tuning)
    content = {
        "scenario": scenario.model_dump(mode="json"),
        "vehicle": load_vehicle(scenario.vehicle).model_dump(mode="json"),
        "imu": load_imu(scenario.imu).model_dump(mode="json"),
        "external": load_external(scenario.external).model_dump(mode="json"),
        "files": [digest_if_there(path) for path in _files_of(scenario)],
        "weights": weights_digest(estimator),
        "tuning": tuning and load_tuning(tuning)[estimator_of(estimator)].model_dump(),
        "run": [estimator, settings.seeds, settings.seed, settings.rate_hz, code],
    }
    return fingerprint(content)


def _save_index(out: Path, results: Results) -> None:
    scenarios = {name: each.model_dump(mode="json") for name, each in results.scenarios.items()}
    settings = {"scenarios": scenarios, "estimators": results.estimators, **asdict(results.settings)}
    index = {
        "version": version("quadsim"),
        "settings": settings,
        "fingerprints": [[cell.scenario, cell.estimator, cell.fingerprint] for cell in results.cells],
        "failed": [asdict(cell) for cell in results.cells if cell.reason],
    }
    write_json(out / "bench.json", index)
