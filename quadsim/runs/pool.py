"""Worker processes that end with their parent."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Any

CLUSTER_LOST = "the cluster was lost; what is finished is kept: give the same command again"


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that share nothing and end with this one; what has not begun when the block ends never does.

    Args:
        workers: How many. Each has one thread for linear algebra: they share the cores among themselves.
    """
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


def give_up(executor: Executor, futures: Iterable[Future[Any]]) -> None:
    """Cancel what has not begun on an executor that goes on without us; a `worker_pool` does so by itself."""
    if not isinstance(executor, ProcessPoolExecutor):
        for future in futures:
            future.cancel()


def end_with_parent() -> None:
    """Let a worker die with its parent, and quietly at Ctrl-C; half a job leaves nothing behind."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
