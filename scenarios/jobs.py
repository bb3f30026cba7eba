"""Work spread over processes, or over any other executor."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import TypeVar

from quadsim.dataset import end_with_parent

Result = TypeVar("Result")


def spread(
    function: Callable[..., Result],
    jobs: Sequence[tuple],
    workers: int | None = None,
    executor: Executor | None = None,
) -> Iterator[tuple[int, Result | BaseException]]:
    """Call a function for every job, and yield the number of the job with its result as they come.

    Args:
        function: Called as function(*job); both must be picklable.
        jobs: Arguments.
        workers: Processes, by default one for each CPU; 1 stays in this process, where an error is raised.
        executor: Where to run in place of processes of our own.

    Yields:
        (i, result of jobs[i]), or the exception in place of the result where the worker itself died.
    """
    workers = min(workers or len(os.sched_getaffinity(0)), len(jobs))
    if executor is not None:
        yield from _submit(executor, function, jobs)
    elif workers <= 1:
        for i, job in enumerate(jobs):
            yield i, function(*job)
    else:
        context = multiprocessing.get_context("spawn")
        with one_thread_each(), ProcessPoolExecutor(workers, context, end_with_parent) as pool:
            yield from _submit(pool, function, jobs)


def _submit(
    executor: Executor, function: Callable[..., Result], jobs: Sequence[tuple]
) -> Iterator[tuple[int, Result | BaseException]]:
    pending: dict[Future[Result], int] = {executor.submit(function, *job): i for i, job in enumerate(jobs)}
    try:
        for future in as_completed(pending):
            error = future.exception()
            yield pending[future], future.result() if error is None else error
    finally:
        for future in pending:
            future.cancel()


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes started inside use one thread for linear algebra: they share the cores among themselves."""
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = before
