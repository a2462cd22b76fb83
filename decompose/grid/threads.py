"""Division of work between the current thread and a thread of an executor."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor

SHARE_COUNT = 2  # number of shares into which work is divided


def run_shares(executor: Executor | None, work: Callable[[int], None]) -> None:
    """Call a function for each share.

    The current thread runs the first share, and then the second one, unless the executor has started that.

    Parameters
    ----------
    executor
        Threads for the second share; None to run all shares in the current thread.
    work
        Function that is called with the number of a share.
    """
    if executor is None:
        for share in range(SHARE_COUNT):
            work(share)
        return
    future = executor.submit(work, 1)
    work(0)
    if future.cancel():
        work(1)
    else:
        future.result()
