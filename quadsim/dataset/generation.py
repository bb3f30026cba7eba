"""Generate a dataset in parallel processes; an interrupted run can be resumed."""

import json
import shutil
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd

from ..config.ranges import Between, steps_of
from ..flight.recipe import Recipe
from ..held_out import unreserved
from ..runs.files import alone
from ..runs.fingerprint import code_digest
from ..runs.pool import process_count, run_jobs
from . import store as dataset_store
from .reading import read_attributes, refuse_damaged
from .store import Plan, Progress, partial_folder

FLIGHTS, SEEDS = Between(1, 10_000_000), Between(0, 2**63 - 1)
BATCH_FLIGHTS = 16  # more gain no speed
BATCH_BYTES = 400e6  # memory that a worker may use for a batch,
SAMPLE_BYTES = 600  # of which a sample of a flight takes this much while it is simulated
WORTH_A_PROCESS = 2_000_000  # samples that take longer than the start of a process does


def generate(
    config: Recipe,
    flights: int,
    duration_s: float,
    out: str | Path,
    seed: int = 0,
    rate_hz: float = 200.0,
    workers: int | None = None,
    progress: Progress = lambda done, total: None,
    overwrite: bool = False,
    held_out: bool = False,
) -> Path:
    """Simulate flights and write them as a labelled Zarr store.

    The files depend only on the configuration, the seed and the code, not on the number of workers. A second
    call with the same arguments resumes an interrupted run. If the dataset is complete and the code has not
    changed, the call returns immediately. Worker processes import the caller's main module, so scripts must
    call this function under `if __name__ == "__main__":`.

    Args:
        config: The recipe of the flights.
        flights: Number of flights. Flight i uses the i-th child of the seed.
        duration_s: Length of each flight [s].
        out: Path of the dataset. Until the dataset is complete, the files are in `out.partial`.
        seed: Seed of all random numbers.
        rate_hz: Samples per second.
        workers: Number of processes; 1 runs in this process. By default one per CPU, or 1 for a small
            dataset.
        progress: Called at the start and after each batch, with the number of finished flights and the total.
        overwrite: Replace another dataset at `out`, whether complete or not.
        held_out: Allow a seed of a held-out suite, for a benchmark. Training and tuning refuse such a
            dataset.

    Returns:
        The path of the dataset.

    Raises:
        ValueError: An argument is invalid, `out` exists with other settings, or another process is writing to
            `out`.
        OSError: The dataset cannot be written, or a worker died. Finished flights are kept.
    """
    plan = _plan(config, flights, duration_s, seed if held_out else unreserved(seed), rate_hz)
    if workers is None and plan.flights * plan.steps < WORTH_A_PROCESS:
        workers = 1
    workers = process_count(workers, plan.flights)
    out = Path(out).expanduser().absolute()
    try:
        with alone(out):
            if _make_way(plan, out, overwrite):
                _fly_all(plan, partial_folder(out), workers, progress)
                dataset_store.finish(partial_folder(out), plan, out)
    except ChildProcessError:
        raise
    except OSError as error:
        raise OSError(f"cannot write {out}: {error.strerror or error}; finished flights are kept") from error
    return out


def _plan(config: Recipe, flights: int, duration_s: float, seed: int, rate_hz: float) -> Plan:
    FLIGHTS.of("flights", flights)
    SEEDS.of("seed", seed)
    if flights != int(flights):
        raise ValueError(f"flights = {flights}: should be a whole number")
    code = code_digest("quadsim.dataset.store")
    steps = steps_of(duration_s, rate_hz)
    return Plan(version("quadsim"), int(seed), int(flights), steps, float(rate_hz), code, config)


def _make_way(plan: Plan, out: Path, overwrite: bool) -> bool:
    """Prepare a new or an unfinished dataset; return False if the complete dataset exists.

    Raises:
        ValueError: The path holds another dataset or another file.
    """
    folder = partial_folder(out)
    if out.exists():
        attributes = read_attributes(out)  # refuses to touch what is not a dataset
        if not overwrite:
            refuse_damaged(out)
            found = {name: attributes[name] for name in plan.content}
            _refuse_other(plan, found | {"config": json.loads(found["config"])}, f"{out} holds")
            shutil.rmtree(folder, ignore_errors=True)
            return False
    if folder.exists():
        if not (folder / "flights").is_dir():
            raise ValueError(
                f"{folder} exists and was not written by quadsim: move it, or choose another --out"
            )
        text = dataset_store.read_plan(folder)
        if text == json.dumps(plan.content):
            return True
        if text and not overwrite:
            _refuse_other(plan, json.loads(text), f"{out} is unfinished and holds")
        shutil.rmtree(folder)
    dataset_store.lay_out(folder, plan)
    return True


def _refuse_other(plan: Plan, other: dict[str, object], what: str) -> None:
    """Raise an error that names the first setting in which a dataset differs from the plan, if any."""
    wanted, found = (pd.json_normalize(each).iloc[0].to_dict() for each in (plan.content, other))
    for key in sorted(wanted.keys() | found.keys(), key=lambda name: (name == "code", name)):
        if wanted.get(key) != found.get(key):
            differs = f"{key} is {found.get(key)}, not {wanted.get(key)}"
            raise ValueError(
                f"{what} another dataset ({'it was made by other code' if key == 'code' else differs}): "
                "choose another --out, or --overwrite it"
            )


def _fly_all(plan: Plan, folder: Path, workers: int, progress: Progress) -> None:
    """Simulate the missing flights."""
    whole = dataset_store.whole_flights(folder)
    missing = [flight for flight in range(plan.flights) if flight not in whole]
    batches = {batch[0]: (plan, folder, batch) for batch in _batches(missing, plan.steps, workers)}
    done = plan.flights - len(missing)
    progress(done, plan.flights)
    with closing(run_jobs(dataset_store.fly_batch, batches, workers)) as finished:
        for _, batch in finished:
            done += len(batch)
            progress(done, plan.flights)


def _batches(flights: list[int], steps: int, workers: int) -> list[list[int]]:
    """Divide the flights into batches of similar size that fit in memory and occupy every worker."""
    if not flights:
        return []
    largest = int(np.clip(BATCH_BYTES // (steps * SAMPLE_BYTES), 1, BATCH_FLIGHTS))
    rounds = -(-len(flights) // (largest * workers))
    parts = np.array_split(flights, min(len(flights), rounds * workers))
    return [part.tolist() for part in parts]
