"""Pool on a cluster. Tasks whose files are not listed run in the pool of this computer instead."""

from __future__ import annotations

import asyncio
import logging
import re
import time
import uuid
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from farm.compute.cluster.cluster_state import (
    ClusterState,
    ClusterWorker,
    Place,
    RunningTask,
    choose_place,
    describe_place,
)
from farm.compute.cluster.installation import Installation, read_installation
from farm.compute.cluster.relocation import dump, load
from farm.compute.cluster.remote_task import (
    AttemptLost,
    InputFile,
    RemoteAnswer,
    RemoteTask,
    hash_files,
    write_files,
)
from farm.compute.cluster.security import check_cluster
from farm.compute.cluster.slot_queue import SlotQueue
from farm.compute.deferred import DeferredFunction
from farm.compute.limits import CHECKING_LIMIT, Limit
from farm.compute.pool import Pool

log = logging.getLogger(__name__)

T = TypeVar("T")
_MAX_ATTEMPTS = 3  # number of attempts on the cluster, after which the task runs on this computer


class ClusterConnection(Protocol):
    """Interface of a connection to a cluster; see `connection.Connection`."""

    async def watch(self) -> None:
        """Connect, stay connected, and report the workers, until the call is cancelled."""

    async def submit(self, task: RemoteTask, contents: dict[str, bytes]) -> RemoteAnswer:
        """Run a task on one of the workers. Raises AttemptLost."""


ConnectionFactory = Callable[
    [Callable[[tuple[ClusterWorker, ...]], None], Callable[[dict[str, Any]], None]], ClusterConnection
]
"""Function that makes a connection from two callbacks: for the list of workers, and for task messages."""


class ClusterPool:
    """Pool on a cluster; see `farm.compute.pool.Pool`.

    Work whose files are not listed (`DeferredFunction.list_files`) runs on this computer, because it is quick
    and a person is waiting. When the cluster has had no usable worker for `cluster_state.WORKER_TIMEOUT_S`,
    all work runs on this computer until the cluster has one.

    Parameters
    ----------
    local_pool
        Pool of this computer.
    scheduler
        Address of the scheduler, for messages.
    installation
        Versions on this computer.
    connect
        Function that makes the connection.
    read_clock_s
        Function that returns the seconds of a monotonic clock.
    """

    def __init__(
        self,
        local_pool: Pool,
        scheduler: str,
        installation: Installation,
        connect: ConnectionFactory,
        read_clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._local_pool, self._scheduler, self._installation = local_pool, scheduler, installation
        self._read_clock_s = read_clock_s
        self._slot_queue = SlotQueue()
        self._workers: tuple[ClusterWorker, ...] = ()
        self._unusable_since_s: float | None = read_clock_s()
        self._running_tasks: dict[str, tuple[RunningTask, RemoteTask]] = {}
        self._local_count = 0
        self._sent_hashes: set[str] = set()  # hashes of files that were already sent to the cluster
        self._close_event = asyncio.Event()  # set while the cluster gets no work
        self._connection = connect(self._on_workers, self._on_message)
        self._watch_task: asyncio.Task[None] | None = None

    @property
    def memory_bytes(self) -> int:
        """Memory that each worker on this computer may use, in bytes."""
        return self._local_pool.memory_bytes

    @property
    def start_step(self) -> str | None:
        """Current step in starting the workers on this computer; see `WorkerPool.start_step`."""
        return self._local_pool.start_step

    @property
    def has_idle_worker(self) -> bool:
        """True if a task would start immediately; see `Pool.has_idle_worker`."""
        return (
            self._local_pool.has_idle_worker
            if choose_place(self._measure_unusable_s()) is Place.THIS_COMPUTER
            else self._slot_queue.has_free_slot
        )

    @property
    def state(self) -> ClusterState:
        """State of the cluster."""
        tasks = tuple(running for running, _ in self._running_tasks.values())
        unusable_s = self._measure_unusable_s()
        return ClusterState(
            self._scheduler,
            choose_place(unusable_s),
            self._workers,
            tasks,
            self._slot_queue.waiting_count,
            self._local_count,
            unusable_s,
        )

    def start(self) -> None:
        """Connect to the cluster, and keep the connection; call it once, in the event loop."""
        self._watch_task = asyncio.get_running_loop().create_task(self._connection.watch())

    async def run(
        self, work: Callable[..., T], *args: object, limit: Limit = CHECKING_LIMIT, group: Hashable = None
    ) -> T:
        """Run a function on the cluster, or on this computer; see `Pool.run`."""
        if not isinstance(work, DeferredFunction) or work.list_files is None:
            return await self._local_pool.run(work, *args, limit=limit, group=group)
        group = object() if group is None else group
        files = work.list_files(*args)
        task = RemoteTask(
            id="",
            call=dump((DeferredFunction(work.target), args)),
            limit=limit,
            installation=self._installation,
            input_files=await asyncio.to_thread(hash_files, files),
            output_folders=tuple(map(str, files.output_folders)),
            output_files=tuple(map(str, files.output_files)),
            cache_folders=tuple(map(str, files.cache_folders)),
            live_files=tuple(map(str, files.live_files)),
        )
        for _ in range(_MAX_ATTEMPTS):
            async with self._slot_queue.hold_slot(group, limit.is_urgent) as has_slot:
                if not has_slot:
                    break
                try:
                    answer = await self._make_attempt(task, group)
                except AttemptLost as lost:
                    log.warning("%s is submitted again: %s", limit.work_name, lost)
                    continue
            if answer.error is not None:
                raise answer.error
            await asyncio.to_thread(write_files, task, answer.files)
            return load(answer.result or b"")  # type: ignore[no-any-return]
        self._local_count += 1
        try:
            return await self._local_pool.run(work, *args, limit=limit, group=group)
        finally:
            self._local_count -= 1

    def close(self) -> None:
        """Abandon all work, and end every worker on this computer; then await `wait_closed`."""
        if self._watch_task is not None:
            self._watch_task.cancel()
        self._local_pool.close()

    async def wait_closed(self) -> None:
        """Wait until a closed pool has disconnected."""
        if self._watch_task is not None:
            with suppress(asyncio.CancelledError):
                await self._watch_task

    async def _make_attempt(self, task: RemoteTask, group: Hashable) -> RemoteAnswer:
        """Run a task on the cluster, first without the files that were already sent. Raises AttemptLost."""
        new_files = tuple(file for file in task.input_files if file.sha256 not in self._sent_hashes)
        for files in (new_files, task.input_files):
            contents = await asyncio.to_thread(_read_contents, files)
            answer = await self._submit_task(task, contents, group)
            self._sent_hashes.update(contents)
            if answer.mismatch is not None:
                raise AttemptLost(f"worker {answer.host}: {answer.mismatch}")
            if not answer.missing_hashes:
                return answer
        raise AttemptLost(f"worker {answer.host} has lost its files")

    async def _submit_task(
        self, task: RemoteTask, contents: dict[str, bytes], group: Hashable
    ) -> RemoteAnswer:
        """Submit a task under a new name, and return the answer. Raises AttemptLost if there is none."""
        name_prefix = re.sub(r"[^a-z]+", "_", task.limit.work_name.lower())
        # Dask learns the durations of tasks whose names have the same prefix.
        named_task = replace(task, id=f"{name_prefix}-{uuid.uuid4().hex}")
        self._running_tasks[named_task.id] = (RunningTask(task.limit.work_name, group), named_task)
        answer_future = asyncio.ensure_future(self._connection.submit(named_task, contents))
        close_future = asyncio.ensure_future(self._close_event.wait())
        try:
            await asyncio.wait({answer_future, close_future}, return_when=asyncio.FIRST_COMPLETED)
            if not answer_future.done():
                raise AttemptLost("the cluster does not answer")
            return answer_future.result()
        finally:
            del self._running_tasks[named_task.id]
            for future in (answer_future, close_future):
                future.cancel()
            await asyncio.gather(answer_future, close_future, return_exceptions=True)

    def _measure_unusable_s(self) -> float:
        if self._unusable_since_s is None:
            return 0.0
        return max(1e-9, self._read_clock_s() - self._unusable_since_s)

    def _on_workers(self, workers: tuple[ClusterWorker, ...]) -> None:
        """Store the state of the workers; called every second."""
        for worker in workers:
            if worker.refusal_reason and worker not in self._workers:
                log.warning("worker %s of the cluster is refused: %s", worker.name, worker.refusal_reason)
        previous_place = choose_place(self._measure_unusable_s())
        slot_count = sum(worker.slot_count for worker in workers if worker.refusal_reason is None)
        self._workers = workers
        if slot_count:
            self._unusable_since_s = None
        elif self._unusable_since_s is None:
            self._unusable_since_s = self._read_clock_s()
        place = choose_place(self._measure_unusable_s())
        if place is not previous_place:
            level = logging.INFO if place is Place.CLUSTER else logging.WARNING
            log.log(level, "%s", describe_place(place, self._scheduler))
        if place is Place.THIS_COMPUTER:
            self._close_event.set()
        else:
            self._close_event.clear()
        self._slot_queue.set_slot_count(slot_count, place is Place.THIS_COMPUTER)

    def _on_message(self, message: dict[str, Any]) -> None:
        """Store the worker of a task, and write its live files."""
        running_task, task = self._running_tasks.get(str(message.get("task")), (None, None))
        if running_task is None or task is None:
            return
        self._running_tasks[task.id] = (replace(running_task, host=str(message.get("host"))), task)
        path, content = message.get("path"), message.get("content")
        if isinstance(content, str) and path in task.live_files:
            with suppress(OSError):  # on a full disk the task itself may still succeed
                write_files(task, {str(path): content.encode()})


def _read_contents(files: tuple[InputFile, ...]) -> dict[str, bytes]:
    """Read files, and return their contents by hash. Raises AttemptLost if a file is gone."""
    try:
        return {file.sha256: Path(file.path).read_bytes() for file in files}
    except OSError as error:
        raise AttemptLost(str(error)) from error


def connect_cluster(local_pool: Pool, scheduler: str, certificates: Path | None) -> ClusterPool:
    """Make a pool on a cluster. Takes a second, because it reads the versions on this computer.

    Parameters
    ----------
    local_pool
        Pool of this computer, which is closed together with the new pool.
    scheduler, certificates
        See `check_cluster`.

    Raises
    ------
    FarmError
        With code `settings` if Dask or a certificate is missing.
    SlicingError
        If CuraEngine or Cura's files are missing.
    """
    check_cluster(scheduler, certificates)
    from farm.compute.cluster.connection import Connection  # loads Dask

    installation = read_installation()
    return ClusterPool(
        local_pool,
        scheduler,
        installation,
        lambda on_workers, on_message: Connection(
            scheduler, certificates, installation, on_workers, on_message
        ),
    )
