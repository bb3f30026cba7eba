"""The closed-loop benchmark: scenarios × estimators × seeds, resumable, the same on any number of workers."""

import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import estimators
from estimators.registry import tuning_misfit
from estimators.tuned import load_tuning
from quadsim.external import load_external
from quadsim.flight.scenario import Scenario, changed, load_scenario
from quadsim.imu.spec import load_imu
from quadsim.runs.files import drop_parts, read_json, write_csv, write_json
from quadsim.runs.fingerprint import ROOT, code_digest, file_digest, fingerprint
from quadsim.runs.spread import spread
from quadsim.vehicle import load_vehicle

from .cell import Cell, Row, digest_if_there, file_name, fly_cell, load_cell, tuning_of, weights_digest

log = logging.getLogger(__name__)

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Settings:
    """What was asked for."""

    scenarios: dict[str, Scenario]
    estimators: list[str]
    seeds: int
    seed: int
    rate_hz: float
    tuning: str | None = None
    """Tuned parameters, in place of the shipped ones."""


@dataclass(frozen=True)
class Results:
    """What came of it: cells in the order of scenarios, then estimators."""

    settings: Settings
    cells: list[Cell]

    @property
    def rows(self) -> list[Row]:
        """One row per cell."""
        return [cell.row for cell in self.cells]

    @property
    def warnings(self) -> list[str]:
        """What to know of parameters that were tuned for something else than was flown."""
        s, found = self.settings, dict[str, dict[str, None]]()
        for scenario in s.scenarios.values():
            for name in s.estimators:
                if other := tuning_misfit(name, tuning_of(name, s.tuning), scenario.vehicle, scenario.imu):
                    flown = f"{Path(scenario.vehicle).stem} with {Path(scenario.imu).stem}"
                    found.setdefault(f"for {other}, not for the {flown} that flew", {})[name] = None
        return [
            f"Tuned {text}: {', '.join(who)}. `quadsim tune` on flights of that vehicle, then --tuning FILE."
            for text, who in found.items()
        ]

    @property
    def flights(self) -> list[Row]:
        """One row per flight."""
        return [flight for cell in self.cells for flight in cell.flights]


def bench(
    scenarios: Sequence[str | Path],
    names: Sequence[str],
    seeds: int,
    out: str | Path,
    *,
    seed: int = 0,
    duration_s: float | None = None,
    vehicle: str | None = None,
    imu: str | None = None,
    external: str | None = None,
    tuning: str | None = None,
    rate_hz: float = 200.0,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Results:
    """Fly every scenario on every estimator with the same seeds, and write `results.csv` and `flights.csv`.

    The results depend on the arguments and the code alone, not on the number of workers. Every finished cell
    is kept under `out/cells`; a later run with the same scenario, estimator, seeds and code takes it from
    there. Worker processes import the caller's main module, so a script calls this under
    `if __name__ == "__main__":`.

    Args:
        scenarios: Names of shipped scenarios or paths of TOML files.
        names: Names of estimators, or paths of weights.
        seeds: Flights in each cell.
        out: Folder for the results.
        seed: Seed of everything random; flight i has its i-th child.
        duration_s: Length of the flights, instead of each scenario's own [s].
        vehicle: Another vehicle for all scenarios: a shipped name or a TOML file; shipped parameters of
            filters are those tuned for it, where there are such, and ekf-drag has its drag.
        imu: Another IMU for all scenarios, likewise.
        tuning: Tuned parameters in place of the shipped ones: a shipped domain or a file of `quadsim tune`;
            estimators that it has no table of keep theirs.
        external: External sensor instead of each scenario's own, for example "ideal".
        rate_hz: Samples per second.
        workers: Processes, by default one for each CPU; 1 stays in this process.
        executor: Where to run in place of processes of our own, for instance a Dask client's
            `get_executor()`.
        progress: Called with the cells done and their total at the start and after each cell.

    Raises:
        ValueError: For a bad argument or scenario file.
        OSError: If the results cannot be written.
    """
    changes = {"duration_s": duration_s, "vehicle": vehicle, "imu": imu, "external": external}
    changes = {key: value for key, value in changes.items() if value is not None}
    settings = _settings(scenarios, names, seeds, seed, changes, tuning, rate_hz)
    out = Path(out).expanduser()
    out.mkdir(parents=True, exist_ok=True)
    drop_parts(out)
    code = suite_digest()
    wanted = [(s, e) for s in settings.scenarios for e in settings.estimators]
    prints = {pair: _fingerprint(settings, *pair, code) for pair in wanted}
    found = {pair: load_cell(cell_path(out, *pair)) for pair in wanted}
    cells = {pair: cell for pair, cell in found.items() if cell and cell.fingerprint == prints[pair]}
    missing = [pair for pair in wanted if pair not in cells]
    if progress:
        progress(len(cells), len(wanted))
    for cell in _fly_all(settings, missing, prints, workers, executor):
        cells[cell.scenario, cell.estimator] = cell
        if cell.reason:
            log.warning("%s on %s did not run: %s", cell.scenario, cell.estimator, cell.reason)
        else:
            cell.save(cell_path(out, cell.scenario, cell.estimator))
        if progress:
            progress(len(cells), len(wanted))
    results = Results(settings, [cells[pair] for pair in wanted])
    write_csv(out / "results.csv", results.rows)
    write_csv(out / "flights.csv", results.flights)
    _save_index(out, results)
    return results


def load_results(out: str | Path) -> Results:
    """The results of an earlier `bench` in its folder.

    Raises:
        ValueError: If there are none, or not all of them.
    """
    out = Path(out).expanduser()
    try:
        index = read_json(out / "bench.json")
        settings = Settings(**(index["settings"] | {"scenarios": _parse(index["settings"]["scenarios"])}))
        failed = {(f["scenario"], f["estimator"]): Cell(**f) for f in index["failed"]}
        fingerprints = {(s, e): print_ for s, e, print_ in index["fingerprints"]}
    except FileNotFoundError:
        raise ValueError(f"{out}: no benchmark results (there is no bench.json)") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{out / 'bench.json'}: not the index of a benchmark: {error}") from error
    cells = []
    for pair in [(s, e) for s in settings.scenarios for e in settings.estimators]:
        cell = failed.get(pair) or load_cell(cell_path(out, *pair))
        if cell is None:
            raise ValueError(f"{cell_path(out, *pair)}: missing or damaged; run the benchmark again")
        if cell.fingerprint != fingerprints.get(pair):
            raise ValueError(
                f"{cell_path(out, *pair)}: of another run than the rest; run the benchmark again"
            )
        cells.append(cell)
    return Results(settings, cells)


def cell_path(out: Path, scenario: str, estimator: str) -> Path:
    """File of a cell."""
    return out / "cells" / f"{scenario}--{file_name(estimator)}.json"


def suite_digest() -> str:
    """Digest of the code and data that a cell's numbers come from: change these, and cells are flown anew."""
    files = [path for path in (ROOT / "assets").rglob("*.*") if "__pycache__" not in path.parts]
    assets = {path.relative_to(ROOT).as_posix(): file_digest(path) for path in files}
    return fingerprint(code_digest("scenarios.bench.cell", "estimators"), assets)


def _settings(
    scenarios: Sequence[str | Path],
    names: Sequence[str],
    seeds: int,
    seed: int,
    changes: Mapping[str, Any],
    tuning: str | None,
    rate_hz: float,
) -> Settings:
    loaded: dict[str, Scenario] = {}
    for source in scenarios:
        scenario, name = load_scenario(source), Path(source).name.removesuffix(".toml")
        scenario = changed(scenario, changes)
        if name in loaded:
            raise ValueError(f'two scenarios are called "{name}"; give one of the files another name')
        load_vehicle(scenario.vehicle)  # a mistake in these is the user's, not a cell's
        load_imu(scenario.imu)
        load_external(scenario.external)
        loaded[name] = scenario
    if tuning is not None and not set(names) & set(load_tuning(tuning)):
        raise ValueError(f"{tuning}: it has no table of {', '.join(names)}")
    for name in names:
        if name not in estimators.names():
            estimators.create(name, rate_hz)  # says which names there are, or what is wrong with the weights
    if not loaded or not names:
        raise ValueError(f"nothing to fly: give at least one {'estimator' if loaded else 'scenario'}")
    if seeds < 1:
        raise ValueError(f"seeds is {seeds}; at least one flight is needed")
    return Settings(loaded, list(dict.fromkeys(names)), seeds, seed, rate_hz, tuning)


def _fingerprint(settings: Settings, name: str, estimator: str, code: str) -> str:
    scenario = settings.scenarios[name]
    content = {
        "scenario": scenario.model_dump(mode="json"),
        "vehicle": load_vehicle(scenario.vehicle).model_dump(mode="json"),
        "imu": load_imu(scenario.imu).model_dump(mode="json"),
        "external": load_external(scenario.external).model_dump(mode="json"),
        "files": [
            digest_if_there(part.path)
            for part in (scenario.trajectory, *scenario.wind)
            if part.kind == "file"
        ],
        "weights": weights_digest(estimator),
        "tuning": tuning and load_tuning(tuning)[estimator].model_dump()
        if (tuning := tuning_of(estimator, settings.tuning))
        else None,
        "run": [estimator, settings.seeds, settings.seed, settings.rate_hz, code],
    }
    return fingerprint(content)


def _fly_all(
    settings: Settings,
    missing: Sequence[tuple[str, str]],
    prints: dict[tuple[str, str], str],
    workers: int | None,
    executor: Executor | None,
) -> Iterator[Cell]:
    jobs = [
        (
            s,
            settings.scenarios[s],
            e,
            settings.seeds,
            settings.seed,
            settings.rate_hz,
            prints[s, e],
            settings.tuning,
        )
        for s, e in missing
    ]
    for i, cell in spread(fly_cell, jobs, workers, executor):
        if isinstance(cell, BaseException):  # the worker itself died
            reason = f"{type(cell).__name__}: {cell}"
            yield Cell(*missing[i], prints[missing[i]], reason, [], [], None)
        else:
            yield cell


def _parse(scenarios: dict[str, object]) -> dict[str, Scenario]:
    return {name: Scenario.model_validate_json(json.dumps(each)) for name, each in scenarios.items()}


def _save_index(out: Path, results: Results) -> None:
    s = results.settings
    settings = {
        "scenarios": {name: each.model_dump(mode="json") for name, each in s.scenarios.items()},
        "estimators": s.estimators, "seeds": s.seeds, "seed": s.seed, "rate_hz": s.rate_hz,
        "tuning": s.tuning,
    }  # fmt: skip
    index = {
        "version": version("quadsim"), "settings": settings,
        "fingerprints": [[cell.scenario, cell.estimator, cell.fingerprint] for cell in results.cells],
        "failed": [vars(cell) for cell in results.cells if cell.reason],
    }  # fmt: skip
    write_json(out / "bench.json", index)
