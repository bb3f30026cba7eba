"""Independent jobs over processes, of which none ends with another's worker."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor
from typing import TypeVar

from .pool import process_count, run_jobs, submit_jobs, worker_pool

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
    workers, numbered = process_count(workers, len(jobs)), dict(enumerate(jobs))
    if executor is not None:
        yield from submit_jobs(executor, function, numbered)
    elif workers == 1:
        yield from run_jobs(function, numbered, workers)
    else:
        yield from _in_processes(workers, function, numbered)


def _in_processes(
    workers: int, function: Callable[..., Result], jobs: dict[int, tuple]
) -> Iterator[tuple[int, Result | BaseException]]:
    """As `spread`: a worker that dies breaks its pool, but ends no job save the one that it was at.

    Jobs begin in order, so that this is one of the first that are unfinished: they run again, in a pool each,
    and all others in a new one.
    """
    groups = [(workers, list(jobs))]
    while groups:
        size, group = groups.pop(0)
        unfinished: list[int] = []
        with worker_pool(size) as pool:
            for i, result in submit_jobs(pool, function, {i: jobs[i] for i in group}):
                if isinstance(result, BrokenExecutor) and len(group) > 1:
                    unfinished.append(i)
                else:
                    yield i, result
        unfinished.sort()
        groups += [(1, [i]) for i in unfinished[: 2 * workers]]
        groups += [(workers, rest)] if (rest := unfinished[2 * workers :]) else []
