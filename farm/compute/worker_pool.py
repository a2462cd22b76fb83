"""Pool of worker processes for decomposition and slicing. They have a low priority and end with the daemon.

Each process runs one task at a time. If the task is cancelled or exceeds its time limit, the process is
killed and replaced by a new one; a crash affects no other task. Groups of tasks, such as the tasks of
one job, share the workers evenly; urgent tasks have one more worker, which starts when all others are busy.
"""

from __future__ import annotations

import asyncio
import logging
import os
import shutil
from collections import Counter
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from farm.compute.limits import CHECKING_LIMIT, Limit
from farm.compute.memory import read_machine_memory_bytes
from farm.compute.worker_process import RaisedError, WarmUp, Worker
from farm.errors import ErrorCode, FarmError

log = logging.getLogger(__name__)

T = TypeVar("T")
_MAX_ATTEMPTS = 2
_RETRY_INTERVAL_S = 5.0
_GB = 2**30
_CLOSED_MESSAGE = "the daemon is shutting down: submit the job again after `farm up`"


def compute_worker_memory_bytes(count: int, memory_gb: float | None) -> int:
    """Return the memory in bytes that a worker may use.

    Parameters
    ----------
    count
        Number of workers.
    memory_gb
        Memory of each worker, from `fleet.yaml`; None for a share of the machine's memory that suffices for a
        large model.
    """
    if memory_gb is not None:
        return int(memory_gb * _GB)
    machine_bytes = read_machine_memory_bytes()
    return int(max(0.8 * machine_bytes / count, min(4 * _GB, machine_bytes / 2)))


@dataclass(frozen=True, slots=True, eq=False)
class _WaitingTask:
    """Task that waits for a worker."""

    group: Hashable
    is_urgent: bool
    worker_future: asyncio.Future[Worker]


class WorkerPool:
    """Pool of worker processes on this computer; see `farm.compute.pool.Pool`.

    Parameters
    ----------
    scratch
        Folder of the pool. It contains a folder for the temporary files of each worker, which is removed when
        the worker ends.
    count
        Number of workers, without the one for urgent tasks; by default, the number of cores.
    memory_gb
        Memory limit of each worker; see `compute_worker_memory_bytes`.
    warm_up
        Function that every worker calls first: it imports the modules that tasks need.
    """

    def __init__(
        self,
        scratch: Path,
        count: int | None = None,
        memory_gb: float | None = None,
        warm_up: WarmUp | None = None,
    ) -> None:
        count = count or len(os.sched_getaffinity(0))
        self._scratch = scratch
        self._memory_bytes = compute_worker_memory_bytes(count, memory_gb)
        self._warm_up = warm_up
        self._is_closed = False
        self._threads = ThreadPoolExecutor(count + 1, thread_name_prefix="worker")
        self._live_workers: set[Worker] = set()
        self._idle_workers: list[Worker] = []
        self._urgent_worker: Worker | None = None
        self._waiting_tasks: list[_WaitingTask] = []
        self._running_counts: Counter[Hashable] = Counter()  # tasks in workers, by group
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir(parents=True)
        for _ in range(count):
            self._start_worker()

    @property
    def pids(self) -> frozenset[int]:
        """Ids of the running processes."""
        return frozenset(worker.pid for worker in self._live_workers)

    @property
    def memory_bytes(self) -> int:
        """Memory that each worker may use, in bytes."""
        return self._memory_bytes

    @property
    def start_step(self) -> str | None:
        """Current step in starting the workers, as text; None once one of them is ready."""
        steps = [worker.start_step for worker in self._live_workers]
        return steps[0] if steps and all(steps) else None

    @property
    def has_idle_worker(self) -> bool:
        """True if a task would start immediately; see `Pool.has_idle_worker`."""
        return any(worker is not self._urgent_worker for worker in self._idle_workers)

    async def run(
        self, work: Callable[..., T], *args: object, limit: Limit = CHECKING_LIMIT, group: Hashable = None
    ) -> T:
        """Run a function in a worker, and once more if the worker dies; see `Pool.run`."""
        exit_text = ""
        group = object() if group is None else group
        for _ in range(_MAX_ATTEMPTS):
            worker = await self._acquire_worker(group, limit.is_urgent)
            is_reusable = False
            self._running_counts[group] += 1
            try:
                async with asyncio.timeout(limit.seconds):
                    loop = asyncio.get_running_loop()
                    answer = await loop.run_in_executor(self._threads, worker.call, work, args)
                is_reusable = not isinstance(answer, MemoryError)
            except TimeoutError:
                raise FarmError(
                    f"{limit.work_name} did not end within {limit.seconds / 60:g} min: scale the model down "
                    "or simplify its mesh",
                    ErrorCode.LIMIT,
                ) from None
            except EOFError:
                if self._is_closed:
                    raise FarmError(_CLOSED_MESSAGE) from None
                exit_text = worker.wait_for_exit()
                log.warning("worker %d ended unexpectedly (%s)", worker.pid, exit_text)
                continue
            finally:
                self._running_counts -= Counter([group])
                self._release_worker(worker, is_reusable)
            if isinstance(answer, MemoryError):
                raise FarmError(
                    f"not enough memory for {limit.work_name} (a worker may use "
                    f"{self._memory_bytes / _GB:.1f} GB): "
                    "scale the model down, simplify its mesh, or raise `memory_gb` in fleet.yaml",
                    ErrorCode.LIMIT,
                )
            if isinstance(answer, RaisedError):
                raise answer.error
            return answer  # type: ignore[no-any-return]
        raise FarmError(
            f"{limit.work_name} ended its worker process {_MAX_ATTEMPTS} times ({exit_text}), usually "
            "because of too little memory: scale the model down or simplify its mesh",
            ErrorCode.LIMIT,
        )

    def close(self) -> None:
        """Abandon all work, and wait for every worker to end."""
        self._is_closed = True
        for worker in self._live_workers:
            worker.end()
        self._live_workers.clear()
        for task in self._waiting_tasks:
            if not task.worker_future.done():
                task.worker_future.set_exception(FarmError(_CLOSED_MESSAGE))
        self._threads.shutdown(wait=False, cancel_futures=True)
        shutil.rmtree(self._scratch, ignore_errors=True)

    def _start_worker(self) -> None:
        worker = Worker(self._scratch, self._memory_bytes, self._warm_up)
        self._live_workers.add(worker)
        self._assign_worker(worker)

    def _replace_worker(self) -> None:
        """Start a worker; if that fails (the disk may be full), retry until it succeeds."""
        if self._is_closed:
            return
        try:
            self._start_worker()
        except OSError as error:
            log.error("no worker can be started: %s; retrying", error)
            asyncio.get_running_loop().call_later(_RETRY_INTERVAL_S, self._replace_worker)

    async def _acquire_worker(self, group: Hashable, is_urgent: bool) -> Worker:
        """Wait for a free worker, preferably one that is ready. Raises FarmError if the pool is closed."""
        if self._is_closed:
            raise FarmError(_CLOSED_MESSAGE)
        free_workers = [
            worker for worker in self._idle_workers if is_urgent or worker is not self._urgent_worker
        ]
        if free_workers:
            worker = max(free_workers, key=lambda worker: worker.start_step is None)
            self._idle_workers.remove(worker)
            return worker
        task = _WaitingTask(group, is_urgent, asyncio.get_running_loop().create_future())
        self._waiting_tasks.append(task)
        if is_urgent:
            self._start_urgent_worker()
        try:
            return await task.worker_future
        except asyncio.CancelledError:
            if task in self._waiting_tasks:
                self._waiting_tasks.remove(task)
            elif task.worker_future.exception() is None:  # cancelled just when a worker became free
                self._assign_worker(task.worker_future.result())
            raise

    def _start_urgent_worker(self) -> None:
        """Start the worker for urgent tasks if it is not running; if that fails, they wait for another."""
        if self._urgent_worker is not None or self._is_closed:
            return
        try:
            worker = self._urgent_worker = Worker(self._scratch, self._memory_bytes, self._warm_up)
        except OSError as error:
            log.error("no worker for urgent tasks can be started: %s", error)
            return
        self._live_workers.add(worker)
        self._assign_worker(worker)

    def _assign_worker(self, worker: Worker) -> None:
        """Give a free worker to the waiting task that is served first, if there is one."""
        open_tasks = [task for task in self._waiting_tasks if not task.worker_future.done()]
        tasks = [task for task in open_tasks if task.is_urgent or worker is not self._urgent_worker]
        if not tasks:
            self._idle_workers.append(worker)
            return
        first = min(tasks, key=lambda task: (not task.is_urgent, self._running_counts[task.group]))
        self._waiting_tasks.remove(first)
        first.worker_future.set_result(worker)

    def _release_worker(self, worker: Worker, is_reusable: bool) -> None:
        """Return a worker to the pool, or replace it if it cannot take more work."""
        if self._is_closed:
            return
        if is_reusable:
            self._assign_worker(worker)
            return
        worker.end()
        self._live_workers.discard(worker)
        if worker is self._urgent_worker:
            self._urgent_worker = None
            if any(task.is_urgent for task in self._waiting_tasks):
                self._start_urgent_worker()
        else:
            self._replace_worker()
        # A dying engine may write a file after its folder was removed, so remove every unused folder.
        used_folders = {worker.folder for worker in self._live_workers}
        for folder in self._scratch.iterdir():
            if folder not in used_folders:
                shutil.rmtree(folder, ignore_errors=True)
