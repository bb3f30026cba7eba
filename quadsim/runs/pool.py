"""Jobs in worker processes that end with their parent: the one loop that waits."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import closing, contextmanager
from multiprocessing.connection import wait
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from .files import write_whole

if TYPE_CHECKING:
    from pydantic import TypeAdapter

WORKER_DIED = "a worker process died (out of memory, or killed); finished work stays: rerun to go on"
UNGUARDED = (
    "worker processes read the script that starts them: put its calls under if __name__ == '__main__':, or "
    "work with one process"
)

Key = TypeVar("Key")
Result = TypeVar("Result")


def run_jobs(
    function: Callable[..., Result],
    jobs: Mapping[Key, tuple],
    workers: int | None = None,
) -> Generator[tuple[Key, Result]]:
    """As `run_all`, but ends with the first job that fails.

    Raises:
        ChildProcessError: A worker process died at the same job twice.
    """
    with closing(run_all(function, jobs, workers)) as results:
        for key, result in results:
            if isinstance(result, BrokenExecutor):
                raise ChildProcessError(WORKER_DIED) from result
            if isinstance(result, BaseException):
                raise result
            yield key, result


def run_all(
    function: Callable[..., Result],
    jobs: Mapping[Key, tuple],
    workers: int | None = None,
    *,
    apart: bool = False,
) -> Generator[tuple[Key, Result | BaseException]]:
    """Call a function for every job; a worker process that dies ends no job save the one that it was at.

    A worker that dies breaks its pool. Jobs begin in order, so that it was at one of the first that are
    unfinished: they run again, in a pool each, and all others in a new one.

    Args:
        function: Called as function(*job); both must be picklable.
        jobs: Arguments by key.
        workers: Processes, by default one for each CPU; 1 stays in this process and runs the jobs in order.
        apart: Whether even one worker is a process of its own, for code that may end it.

    Yields:
        The key of each job with its result as they end; in place of a result, the exception of a worker.
    """
    workers = process_count(workers, len(jobs))
    if workers == 1 and not apart:
        for key, job in jobs.items():
            yield key, function(*job)
        return
    groups = [(workers, list(jobs))]
    while groups:
        size, group = groups.pop(0)
        finished: set[Key] = set()
        with worker_pool(size) as pool:
            for key, result in _submit(pool, function, {key: jobs[key] for key in group}):
                if len(group) == 1 or not isinstance(result, BrokenExecutor):
                    finished.add(key)
                    yield key, result
        unfinished = [key for key in group if key not in finished]
        groups += [(1, [key]) for key in unfinished[: 2 * workers]]
        groups += [(workers, rest)] if (rest := unfinished[2 * workers :]) else []


def run_stored(
    function: Callable[..., Result],
    jobs: Mapping[Path, tuple],
    form: "TypeAdapter[Result]",
    workers: int | None = None,
    *,
    keep: Callable[[Result], bool] = lambda result: True,
    apart: bool = False,
) -> Generator[tuple[Path, Result | BaseException]]:
    """As `run_all`, of jobs by the file of their result, which is read where an earlier run left it whole.

    A file is written as soon as its job ends, in the JSON of `form`, if the result is worth keeping.
    """
    missing = {}
    for file, job in jobs.items():
        try:
            stored = form.validate_json(file.read_bytes())
        except (OSError, ValueError):
            missing[file] = job
        else:
            yield file, stored
    for file, result in run_all(function, missing, workers, apart=apart):
        if not isinstance(result, BaseException) and keep(result):
            write_whole(file, form.dump_json(result))
        yield file, result


def _submit(
    pool: ProcessPoolExecutor, function: Callable[..., Result], jobs: Mapping[Key, tuple]
) -> Iterator[tuple[Key, Result | BaseException]]:
    """Run jobs in a pool; yields the exception in place of the result where a job failed."""
    running = {pool.submit(function, *job): key for key, job in jobs.items()}
    while running:
        for future in wait_for(running, return_when="FIRST_COMPLETED").done:
            error = future.exception()
            yield running.pop(future), future.result() if error is None else error


def process_count(workers: int | None, jobs: int) -> int:
    """Processes for so many jobs: as many as asked for, or one for each CPU, but no more than jobs."""
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: at least 1 is required")
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(workers or cpus, jobs))


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that share nothing and end with this one; what has not begun when the block ends never does.

    Args:
        workers: How many. Each has one thread for linear algebra: they share the cores among themselves.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        sys.exit(UNGUARDED)
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    # No threads or locks are inherited half way.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), end_with_parent)
    try:
        yield pool
    finally:
        # A future cancelled by hand, while its pool breaks at Ctrl-C, would be an error in the pool's thread.
        pool.shutdown(wait=True, cancel_futures=True)
        if before is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = before


def end_with_parent() -> None:
    """Let a worker die with its parent, and quietly at Ctrl-C; half a job leaves nothing behind."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
