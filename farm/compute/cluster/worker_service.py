"""Service of a worker, which joins a cluster, and joins it again after a restart of the scheduler."""

from __future__ import annotations

import asyncio
import logging
import signal
from dataclasses import dataclass
from pathlib import Path

from farm.compute.cluster.dask_worker import FarmWorker
from farm.compute.cluster.installation import read_installation
from farm.compute.cluster.security import make_security
from farm.compute.cluster.task_executor import TaskExecutor
from farm.compute.worker_pool import WorkerPool
from farm.compute.worker_process import WarmUp

log = logging.getLogger(__name__)
_RETRY_INTERVAL_S = 2.0


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """Options of `farm worker`.

    Attributes
    ----------
    folder
        Folder for caches and tasks, used by this worker only.
    slot_count
        Maximum number of tasks that the worker runs at the same time.
    memory_gb
        Memory limit of each task; None for a share of the machine's memory.
    """

    scheduler: str
    certificates: Path | None
    name: str
    folder: Path
    slot_count: int
    memory_gb: float | None = None


async def serve_tasks(options: WorkerOptions, warm_up: WarmUp | None) -> None:
    """Run tasks for the farms that use a cluster, until SIGTERM or Ctrl-C.

    Parameters
    ----------
    options
        Scheduler, certificates, folder and limits of the worker.
    warm_up
        Function that every process calls first; see `WorkerPool`.

    Raises
    ------
    FarmError
        See `make_security`.
    SlicingError
        See `read_installation`.
    """
    stop_event = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop_event.set)
    security = make_security(options.scheduler, options.certificates)
    installation = await asyncio.to_thread(read_installation)
    pool = WorkerPool(options.folder / "processes", options.slot_count, options.memory_gb, warm_up)
    executor = TaskExecutor(options.name, options.folder, pool, installation)
    try:
        while not stop_event.is_set():
            worker = FarmWorker(
                options.scheduler, executor, options.slot_count, options.folder / "dask", security
            )
            await _serve_once(worker, stop_event)
            if not stop_event.is_set():
                log.warning("the connection to %s ended; connecting again", options.scheduler)
                await asyncio.sleep(_RETRY_INTERVAL_S)
    finally:
        pool.close()


async def _serve_once(worker: FarmWorker, stop_event: asyncio.Event) -> None:
    """Serve until the scheduler is lost or the worker is stopped."""

    async def serve() -> None:
        await worker
        log.info("worker %s serves %s", worker.name, worker.scheduler.address)
        await worker.finished()

    serve_future = asyncio.ensure_future(serve())
    stop_future = asyncio.ensure_future(stop_event.wait())
    await asyncio.wait({serve_future, stop_future}, return_when=asyncio.FIRST_COMPLETED)
    for task in (serve_future, stop_future):
        task.cancel()
    for result in await asyncio.gather(serve_future, stop_future, return_exceptions=True):
        if isinstance(result, Exception):
            log.warning("worker %s: %s", worker.name, result.__cause__ or result)
    await worker.close(reason="the worker ends" if stop_event.is_set() else "the scheduler is gone")
