"""The closed-loop benchmark: scenarios × estimators × seeds, resumable, on any number of workers."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import estimators
from estimators.control.controller import GROUP, LOIHI, create_controller, is_controller, make_controller
from estimators.custom import own_sources
from estimators.networks.weights_file import END
from estimators.registry import is_weights
from estimators.tuned import load_tuning
from quadsim.external import load_external
from quadsim.flight.scenario import Scenario, changed
from quadsim.imu.spec import load_imu
from quadsim.own import is_own, own_files
from quadsim.runs.files import alone
from quadsim.runs.fingerprint import ASSETS, ROOT, code_digest, content_digest, file_digest, fingerprint
from quadsim.runs.pool import run_stored
from quadsim.vehicle import load_vehicle

from .cell import CELL, Cell, FlightSettings, fly_cell, tuning_of
from .controllers import controller_of, estimator_of
from .experiment import SUITE, Experiment
from .results import Results, save_results

log = logging.getLogger(__name__)

Progress = Callable[[int, int], None]
Changes = Mapping[str, Any]
"""Fields that replace those of every scenario, such as vehicle, imu, external, engine and duration_s."""
NO_CHANGES: Changes = {}
Job = tuple[str, Scenario, str]
"""Name of a scenario, the scenario, and a contender."""


def bench(
    scenarios: Sequence[str | Path] | None,
    names: Sequence[str],
    out: str | Path,
    settings: FlightSettings,
    changes: Changes = NO_CHANGES,
    *,
    experiment: Experiment = SUITE,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Results:
    """Fly every scenario with every estimator and the same seeds; write `flights.parquet` and `results.csv`.

    The results do not depend on the number of workers. Every finished cell is stored in `out/cells`. A later
    run with the same scenario, estimator, seeds and code reads the stored cell. Worker processes import the
    caller's main module, so scripts must call this function under `if __name__ == "__main__":`.

    Args:
        scenarios: Names of shipped scenarios or paths of TOML files; None for the scenarios of the
            experiment.
        names: Names of estimators, or paths of weights.
        out: Folder for the results.
        settings: Seeds, sample rate and tuning.
        changes: Fields that replace those of every scenario.
        experiment: Experiment with conditions and sweeps; by default, there are none.
        workers: Number of processes, by default one per CPU; 1 runs in this process.
        progress: Called at the start and after each cell, with the number of finished cells and the total.

    Raises:
        ValueError: An argument or a scenario file is invalid, or another process is writing to `out`.
        OSError: The results cannot be written.
    """
    names, out = list(dict.fromkeys(names)), Path(out).expanduser()
    varied = {name for levels in experiment.axes.values() for level in levels.values() for name in level}
    if both := sorted(varied & changes.keys()):
        raise ValueError(f"{both[0]}: the experiment varies it")
    cases = experiment.cases(scenarios)
    flown = {name: changed(case.scenario, changes) for name, case in cases.items()}
    _check(flown, names, settings)
    jobs = [(name, scenario, each) for name, scenario in flown.items() for each in names]
    files = [out / "cells" / f"{each[:32]}.json" for each in _fingerprints(jobs, settings)]
    progress = progress or (lambda done, total: None)
    cells: dict[Path, Cell] = {}
    said: set[tuple[str, str]] = set()
    with alone(out):
        out.mkdir(parents=True, exist_ok=True)
        progress(0, len(jobs))
        todo = {file: (*job, settings) for file, job in zip(files, jobs, strict=True)}
        for file, cell in run_stored(fly_cell, todo, CELL, workers, keep=lambda cell: not cell.reason):
            if isinstance(cell, BaseException):  # the worker itself died
                cell = Cell(todo[file][0], todo[file][2], f"{type(cell).__name__}: {cell}")
            if cell.reason and (cell.estimator, cell.reason) not in said:  # once for all scenarios
                log.warning("%s with %s did not run: %s", cell.scenario, cell.estimator, cell.reason)
                said.add((cell.estimator, cell.reason))
            cells[file] = cell
            progress(len(cells), len(jobs))
        levels = {name: case.levels for name, case in cases.items() if case.levels}
        results = Results(flown, names, settings, [cells[file] for file in files], experiment, levels)
        save_results(out, results)
        return results


def files_of(scenario: Scenario, contender: str) -> list[str | Path]:
    """Return the files that a cell reads in addition to presets: weights and user code."""
    name, controller = estimator_of(contender), controller_of(contender)
    found: list[str | Path] = [name] if is_weights(name) else [*own_sources(name)]
    if is_controller(controller):
        path = controller.removesuffix(LOIHI)
        found += [path] if path.endswith(END) else []
    elif is_own(controller, GROUP):
        found += own_files(controller, GROUP)
    if scenario.trajectory.kind == "function":
        found += own_files(scenario.trajectory.function)
    return found


def flight_code() -> str:
    """Return the digest of the code and data of a cell. If it changes, cells run again."""
    files = [path for path in ASSETS.rglob("*.*") if "__pycache__" not in path.parts]
    assets = {path.relative_to(ROOT).as_posix(): file_digest(path) for path in files}
    return fingerprint(code_digest("scenarios.bench.cell", "estimators"), assets)


def _check(scenarios: Mapping[str, Scenario], names: Sequence[str], settings: FlightSettings) -> None:
    """Check inputs that `_fingerprints` does not read."""
    if settings.tuning is not None and not set(map(estimator_of, names)) & set(load_tuning(settings.tuning)):
        raise ValueError(f"{settings.tuning}: it has no table of {', '.join(names)}")
    for name in dict.fromkeys(map(estimator_of, names)):
        if name not in estimators.names():
            estimators.create(name, settings.rate_hz)  # raises: the valid ones, or what is wrong with weights
    for name in dict.fromkeys(map(controller_of, names)):
        make_controller(name)
        if is_controller(name):
            create_controller(name, settings.rate_hz)
    if not scenarios or not names:
        raise ValueError(f"nothing to fly: give at least one {'estimator' if scenarios else 'scenario'}")


def _fingerprints(jobs: Sequence[Job], settings: FlightSettings) -> Iterator[str]:
    """Return the fingerprint of each cell.

    Raises:
        ValueError: A scenario's vehicle, IMU or external sensor cannot be read.
    """
    code = flight_code()
    for name, scenario, contender in jobs:
        tuning = tuning_of(contender, settings.tuning)
        specs = (
            scenario,
            load_vehicle(scenario.vehicle),
            load_imu(scenario.imu),
            load_external(scenario.external),
        )
        yield fingerprint(
            [each.model_dump(mode="json") for each in specs],
            [_digest_if_there(path) for path in files_of(scenario, contender)],
            tuning and load_tuning(tuning)[estimator_of(contender)].model_dump(),
            [name, contender, settings.seeds, settings.seed, settings.rate_hz, code],
        )


def _digest_if_there(path: str | Path) -> str:
    """Return the digest of a file that a cell reads; empty if it cannot be read, which fails in the cell."""
    try:
        return content_digest(Path(path).read_bytes())
    except OSError:
        return ""
