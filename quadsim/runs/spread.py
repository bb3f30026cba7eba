"""Work spread over processes, or over any other executor."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, as_completed
from typing import TypeVar

from .pool import CLUSTER_LOST, give_up, worker_pool

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
        yield from _in_processes(workers, function, jobs)


def _in_processes(
    workers: int, function: Callable[..., Result], jobs: Sequence[tuple]
) -> Iterator[tuple[int, Result | BaseException]]:
    """As `spread`: a worker that dies breaks its pool, but ends no job save the one that it was at.

    Jobs begin in order, so that this is one of the first that are unfinished: they run again, in a pool each,
    and all others in a new one.
    """
    groups = [(workers, list(range(len(jobs))))]
    while groups:
        size, group = groups.pop(0)
        unfinished: list[int] = []
        with worker_pool(size) as pool:
            for at, result in _submit(pool, function, [jobs[i] for i in group]):
                if isinstance(result, BrokenExecutor) and len(group) > 1:
                    unfinished.append(group[at])
                else:
                    yield group[at], result
        suspects = sorted(unfinished)[: 2 * workers]
        groups += [(1, [i]) for i in suspects]
        rest = sorted(unfinished)[2 * workers :]
        groups += [(workers, rest)] if rest else []


def _submit(
    executor: Executor, function: Callable[..., Result], jobs: Sequence[tuple]
) -> Iterator[tuple[int, Result | BaseException]]:
    pending: dict[Future[Result], int] = {executor.submit(function, *job): i for i, job in enumerate(jobs)}
    try:
        for future in as_completed(pending):
            error = future.exception()
            yield pending[future], future.result() if error is None else error
    except CancelledError as error:
        raise ChildProcessError(CLUSTER_LOST) from error
    finally:
        give_up(executor, pending)
