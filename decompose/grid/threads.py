"""Work divided between this thread and one of an executor."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor

SHARES = 2  # number of shares that work is divided into


def run_shares(executor: Executor | None, work: Callable[[int], None]) -> None:
    """Call work for each share, the second one in an executor, or here if the executor has not started it."""
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
