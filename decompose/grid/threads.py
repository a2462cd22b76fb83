"""Work that is divided between this thread and one of an executor."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor

SHARES = 2  # number of shares that work is divided into


def run_shares(executor: Executor | None, work: Callable[[int], None]) -> None:
    """Call a function for each share: the second one in an executor, or here if that has not started it.

    Parameters
    ----------
    executor
        Threads; None to run all shares here.
    work
        Function of the number of a share.
    """
    if executor is None:
        for share in range(SHARES):
            work(share)
        return
    second = executor.submit(work, 1)
    work(0)
    if second.cancel():
        work(1)
    else:
        second.result()
