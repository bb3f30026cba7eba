"""The closed-loop benchmark: scenarios × estimators × seeds, resumable, the same on any number of workers."""

import csv
import hashlib
import json
import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

import estimators
from quadsim.external import load_external
from quadsim.imu import load_imu
from quadsim.scenario import Scenario, load_scenario
from quadsim.vehicle import load_vehicle

from .cell import Cell, Row, file_digest, file_name, fly_cell, load_cell, weights_digest
from .jobs import spread

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
    external: str | None = None,
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
    settings = _settings(scenarios, names, seeds, seed, duration_s, external, rate_hz)
    out = Path(out).expanduser()
    out.mkdir(parents=True, exist_ok=True)
    code = code_digest()
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
        index = json.loads((out / "bench.json").read_text())
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


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write rows under the union of their keys; numbers in full."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)


def code_digest() -> str:
    """Digest of the code and data that numbers come from: change these, and cells are flown anew."""
    digest = hashlib.sha256(f"{version('numpy')} {version('mujoco')} {version('numba')}".encode())
    for package in ("quadsim", "estimators", "assets"):
        for name, item in sorted(_files(files(package))):
            digest.update(f"{package}/{name}".encode() + item.read_bytes())
    for name in ("cell.py", "metrics.py"):
        digest.update((files("scenarios") / name).read_bytes())
    return digest.hexdigest()


def _files(folder: Traversable, prefix: str = "") -> Iterator[tuple[str, Traversable]]:
    for item in folder.iterdir():
        if item.is_dir() and item.name != "__pycache__":
            yield from _files(item, f"{prefix}{item.name}/")
        elif item.is_file() and not item.name.startswith("."):
            yield prefix + item.name, item


def _settings(
    scenarios: Sequence[str | Path], names: Sequence[str], seeds: int, seed: int, duration_s: float | None,
    external: str | None, rate_hz: float,
) -> Settings:  # fmt: skip
    loaded: dict[str, Scenario] = {}
    for source in scenarios:
        scenario, name = load_scenario(source), Path(source).name.removesuffix(".toml")
        if duration_s is not None:
            if not 0 < duration_s <= 3600:
                raise ValueError(f"duration is {duration_s} s; it must be above 0 and at most 3600")
            scenario = scenario.model_copy(update={"duration_s": duration_s})
        if external is not None:
            scenario = scenario.model_copy(update={"external": external})
        if name in loaded:
            raise ValueError(f'two scenarios are called "{name}"; give one of the files another name')
        load_vehicle(scenario.vehicle)  # a mistake in these is the user's, not a cell's
        load_imu(scenario.imu)
        load_external(scenario.external)
        loaded[name] = scenario
    for name in names:
        if name not in estimators.names():
            estimators.create(name, rate_hz)  # says which names there are, or what is wrong with the weights
    if not loaded or not names:
        raise ValueError(f"nothing to fly: give at least one {'estimator' if loaded else 'scenario'}")
    if seeds < 1:
        raise ValueError(f"seeds is {seeds}; at least one flight is needed")
    return Settings(loaded, list(dict.fromkeys(names)), seeds, seed, rate_hz)


def _fingerprint(settings: Settings, name: str, estimator: str, code: str) -> str:
    scenario = settings.scenarios[name]
    content = {
        "scenario": scenario.model_dump(mode="json"),
        "vehicle": load_vehicle(scenario.vehicle).model_dump(mode="json"),
        "imu": load_imu(scenario.imu).model_dump(mode="json"),
        "external": load_external(scenario.external).model_dump(mode="json"),
        "files": [
            file_digest(part.path) for part in (scenario.trajectory, *scenario.wind) if part.kind == "file"
        ],
        "weights": weights_digest(estimator),
        "run": [estimator, settings.seeds, settings.seed, settings.rate_hz, code],
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _fly_all(
    settings: Settings,
    missing: Sequence[tuple[str, str]],
    prints: dict[tuple[str, str], str],
    workers: int | None,
    executor: Executor | None,
) -> Iterator[Cell]:
    jobs = [
        (s, settings.scenarios[s], e, settings.seeds, settings.seed, settings.rate_hz, prints[s, e])
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
    }  # fmt: skip
    index = {
        "version": version("quadsim"), "settings": settings,
        "fingerprints": [[cell.scenario, cell.estimator, cell.fingerprint] for cell in results.cells],
        "failed": [vars(cell) for cell in results.cells if cell.reason],
    }  # fmt: skip
    partial = out / "bench.json.partial"
    partial.write_text(json.dumps(index))
    partial.replace(out / "bench.json")
