"""Calls of benches on a cluster (`--scheduler`), or on this computer.

The cluster's workers must be able to import the package `bench`: start each in a checkout, with
``PYTHONPATH=. .venv/bin/farm worker tls://HOST:8786 --certificates FOLDER``.
"""

from __future__ import annotations

import argparse
import asyncio
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

from farm.compute import DeferredFunction, Limit, WorkerPool
from farm.compute.cluster import connect_cluster

Call = Callable[..., Any]
"""Function that calls a deferred function with arguments, and waits for its result; any thread may use it."""
LIMIT = Limit("measuring", 6 * 3600.0)
MAX_PARALLEL_CALLS = 64
"""Maximum number of parallel calls on a cluster, which runs as many as it has slots."""


def add_cluster_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a cluster."""
    parser.add_argument("--scheduler", help="compute on the cluster of this scheduler, tls://HOST:PORT")
    parser.add_argument("--certificates", type=Path, help="folder with ca.pem, cert.pem and key.pem")


def count_calls(args: argparse.Namespace, local_count: int = 1) -> int:
    """Return the number of calls that a bench makes at the same time: on a cluster, or locally."""
    return local_count if args.scheduler is None else MAX_PARALLEL_CALLS


@contextmanager
def open_calls(args: argparse.Namespace, local_call: Call | None = None) -> Iterator[Call]:
    """Open the executor of calls: the cluster, or this computer.

    Parameters
    ----------
    args
        Options of `add_cluster_options`.
    local_call
        Executor of calls without a cluster; None for the calling thread.
    """
    if args.scheduler is None:
        yield local_call or (lambda work, *arguments: work(*arguments))
        return
    with tempfile.TemporaryDirectory(prefix="farm-bench-") as scratch:
        local_workers = WorkerPool(Path(scratch) / "local", 1)
        with open_pool(lambda: connect_cluster(local_workers, args.scheduler, args.certificates)) as call:
            yield call


@contextmanager
def open_pool(connect: Callable[[], Any]) -> Iterator[Call]:
    """Run a pool of a cluster in a thread, and make calls on it.

    Parameters
    ----------
    connect
        Function that makes the pool; see `connect_cluster`.
    """
    loop = asyncio.new_event_loop()
    thread = Thread(target=loop.run_forever, daemon=True)
    thread.start()

    async def start() -> Any:
        pool = connect()
        pool.start()
        return pool

    async def run(work: DeferredFunction, arguments: tuple[Any, ...]) -> Any:
        return await pool.run(work, *arguments, limit=LIMIT)

    async def stop() -> None:
        pool.close()
        await pool.wait_closed()

    pool: Any = asyncio.run_coroutine_threadsafe(start(), loop).result()
    try:
        yield lambda work, *arguments: asyncio.run_coroutine_threadsafe(run(work, arguments), loop).result()
    finally:
        asyncio.run_coroutine_threadsafe(stop(), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
