"""The pool of worker processes for decomposition and slicing: nice 19, and never outliving the daemon."""

from __future__ import annotations

import asyncio
import ctypes
import multiprocessing
import os
import signal
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from farm.errors import FarmError

T = TypeVar("T")
_PR_SET_PDEATHSIG = 1
_TRIES = 2


def _prepare_worker() -> None:
    """Run politely, and die with the daemon (Linux: the kernel sends the signal)."""
    os.nice(19)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


class Workers:
    """As many processes as cores. A worker that dies costs the work that it had, and a new pool."""

    def __init__(self, count: int | None = None) -> None:
        self._count = count or len(os.sched_getaffinity(0))
        self._pool: Executor = self._new_pool()

    def _new_pool(self) -> Executor:
        context = multiprocessing.get_context("spawn")  # the daemon has threads: a fork could hang
        return ProcessPoolExecutor(self._count, mp_context=context, initializer=_prepare_worker)

    def warm(self, work: Callable[[], None]) -> None:
        """Let every worker import what it will need, before somebody waits for it."""
        for _ in range(self._count):
            self._pool.submit(work)

    async def run(self, work: Callable[..., T], *args: object) -> T:
        """Run a function, which may be run more than once, in a worker.

        Raises
        ------
        FarmError
            What the work raised, or that its worker died (out of memory, most often).
        """
        for _ in range(_TRIES):
            pool = self._pool
            try:
                return await asyncio.get_running_loop().run_in_executor(pool, work, *args)
            except BrokenProcessPool:
                # A pool breaks as a whole: whoever had work in it tries again, and only who broke it fails.
                if self._pool is pool:
                    self._pool = self._new_pool()
        raise FarmError(f"the worker processes died {_TRIES} times over this job: is there enough memory?")

    def close(self) -> None:
        """Give up whatever is being worked on."""
        self._pool.shutdown(wait=False, cancel_futures=True)
