"""Connection to the scheduler of a Dask cluster. The connection reports workers, and runs tasks on them."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import dask
from distributed import Client
from distributed.client import FutureCancelledError
from distributed.scheduler import KilledWorker

from farm.compute.cluster.cluster_state import ClusterWorker
from farm.compute.cluster.dask_worker import RESOURCE, TOPIC, run_task
from farm.compute.cluster.installation import Installation
from farm.compute.cluster.remote_task import AttemptLost, RemoteAnswer, RemoteTask
from farm.compute.cluster.security import make_security

log = logging.getLogger(__name__)

_POLL_INTERVAL_S = 1.0  # wall seconds between two checks of the workers
_ANSWER_TIMEOUT_S = 10.0  # wall seconds within which the scheduler must answer
_CONNECT_TIMEOUT_S = 10.0
_HEARTBEAT_TIMEOUT_S = 20.0
"""Wall seconds without a heartbeat after which a worker is removed; one is due every second or two."""

MessageListener = Callable[[dict[str, Any]], None]
WorkersListener = Callable[[tuple[ClusterWorker, ...]], None]


class Connection:
    """Connection to a scheduler. After each loss, it connects again.

    Parameters
    ----------
    scheduler
        Address, such as tls://host:8786.
    certificates
        Folder of certificates; None for a scheduler on this computer without TLS.
    installation
        Versions on this computer; workers with other versions are refused.
    on_workers
        Called every second with the workers, or with an empty tuple if the scheduler does not answer.
    on_message
        Called with messages of running tasks; see `dask_worker.run_task`.

    Raises
    ------
    FarmError
        See `make_security`.
    """

    def __init__(
        self,
        scheduler: str,
        certificates: Path | None,
        installation: Installation,
        on_workers: WorkersListener,
        on_message: MessageListener,
    ) -> None:
        self._scheduler, self._installation = scheduler, installation
        self._security = make_security(scheduler, certificates)
        self._on_workers, self._on_message = on_workers, on_message
        self._client: Client | None = None
        self._workers: tuple[ClusterWorker, ...] = ()
        # Each future is set once all workers at its addresses are gone.
        self._attempts: dict[asyncio.Future[None], frozenset[str]] = {}
        # Last heartbeat of each worker, by address, and the time at which that heartbeat was first seen.
        self._heartbeats: dict[str, tuple[float, float]] = {}
        _redirect_log()
        dask.config.set({"distributed.admin.large-graph-warning-threshold": "16 GiB"})  # models are large

    async def watch(self) -> None:
        """Connect, and report the workers, until the call is cancelled."""
        report_task = asyncio.get_running_loop().create_task(self._repeat_report())
        try:
            while True:
                try:
                    await self._watch_once()
                except OSError as error:  # includes TimeoutError
                    log.info("no connection to the scheduler %s: %s", self._scheduler, error)
                self._report_workers(())
                await self._disconnect()
                await asyncio.sleep(_POLL_INTERVAL_S)
        finally:
            report_task.cancel()
            await self._disconnect()

    async def submit(self, task: RemoteTask, contents: dict[str, bytes]) -> RemoteAnswer:
        """Run a task on one of the workers.

        Parameters
        ----------
        task
            The task, whose id must be unique.
        contents
            Files to send with it, by their hash.

        Raises
        ------
        AttemptLost
            If there is no answer: the cluster is gone, or all workers that could run the task have left it.
            The task may be submitted again, under another id.
        """
        client = self._client
        usable_addresses = [worker.address for worker in self._workers if worker.refusal_reason is None]
        if client is None or not usable_addresses:
            raise AttemptLost("there is no cluster")
        future = client.submit(
            run_task,
            task,
            contents,
            client.id,
            key=task.id,
            pure=False,
            workers=usable_addresses,
            allow_other_workers=False,
            resources={RESOURCE: 1},
            priority=1 if task.limit.is_urgent else 0,
        )
        try:
            answer = await self._await_answer(future, frozenset(usable_addresses))
        except (FutureCancelledError, KilledWorker, OSError) as error:
            raise AttemptLost(str(error)) from error
        finally:
            if not future.done():
                with contextlib.suppress(Exception):  # without a scheduler, the task is gone
                    cancellation = asyncio.ensure_future(future.cancel(force=True))
                    cancellation.add_done_callback(_ignore_result)
            future.release()
        if not isinstance(answer, RemoteAnswer):
            raise AttemptLost(f"the cluster answered with {type(answer).__name__}")
        return answer

    async def _await_answer(self, future: Any, addresses: frozenset[str]) -> object:
        """Wait for an answer, or until all workers that could run the task are gone. Raises AttemptLost."""
        loss_future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        answer_future = asyncio.ensure_future(_await_future(future))
        self._attempts[loss_future] = addresses
        try:
            futures: set[asyncio.Future[Any]] = {answer_future, loss_future}
            await asyncio.wait(futures, return_when=asyncio.FIRST_COMPLETED)
            if not answer_future.done():
                raise AttemptLost("its workers have left the cluster")
            return answer_future.result()
        finally:
            del self._attempts[loss_future]
            answer_future.cancel()

    async def _watch_once(self) -> None:
        """Connect, and watch the workers until the connection is lost."""
        self._client = await Client(
            self._scheduler,
            security=self._security,
            asynchronous=True,
            timeout=_CONNECT_TIMEOUT_S,
            set_as_default=False,
            name="farm",
        )
        self._client.subscribe_topic(TOPIC.format(self._client.id), self._on_event)
        log.info("connected to the scheduler %s", self._scheduler)
        while self._client.status == "running":
            async with asyncio.timeout(_ANSWER_TIMEOUT_S):
                identity = await self._client.scheduler.identity()
            workers = list_workers(identity["workers"], self._installation)
            await self._remove_silent_workers(identity["workers"])
            self._report_workers(workers)
            await asyncio.sleep(_POLL_INTERVAL_S)

    def _on_event(self, event: tuple[float, dict[str, Any]]) -> None:
        self._on_message(event[1])

    def _report_workers(self, workers: Sequence[ClusterWorker]) -> None:
        self._workers = tuple(workers)
        present_addresses = {worker.address for worker in workers}
        for loss_future, addresses in self._attempts.items():
            if present_addresses and present_addresses.isdisjoint(addresses) and not loss_future.done():
                loss_future.set_result(None)  # Dask would wait even if they return under new addresses
        self._on_workers(self._workers)

    async def _repeat_report(self) -> None:
        """Report the last list of workers every second, even while there is no connection."""
        while True:
            await asyncio.sleep(_POLL_INTERVAL_S)
            self._on_workers(self._workers)

    async def _remove_silent_workers(self, records: dict[str, dict[str, Any]]) -> None:
        """Remove workers without a recent heartbeat, so that their tasks go to other workers.

        By default, Dask removes such workers only after five minutes.
        """
        now_s = time.monotonic()
        for address in list_silent_workers(records, self._heartbeats, now_s):
            if self._client is not None:
                log.warning("worker %s is silent: its tasks go to others", records[address]["name"])
                await self._client.scheduler.unregister(address=address, stimulus_id=f"farm-silent-{now_s}")

    async def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            close_future = asyncio.ensure_future(client.close(timeout=_POLL_INTERVAL_S))
            close_future.add_done_callback(_ignore_result)
            await asyncio.wait({close_future}, timeout=_POLL_INTERVAL_S)


async def _await_future(future: Any) -> object:
    return await future


def list_workers(records: dict[str, dict[str, Any]], installation: Installation) -> tuple[ClusterWorker, ...]:
    """List the workers that run tasks of farms, in order of their addresses, and compare their versions."""
    workers = []
    for address, record in sorted(records.items()):
        versions = record.get(RESOURCE)
        if isinstance(versions, dict):
            refusal_reason = Installation.from_record(versions).describe_difference(installation)
            slot_count = int(record["nthreads"])
            workers.append(ClusterWorker(str(record["name"]), address, slot_count, refusal_reason))
    return tuple(workers)


def list_silent_workers(
    records: dict[str, dict[str, Any]], heartbeats: dict[str, tuple[float, float]], now_s: float
) -> list[str]:
    """Return the addresses of the workers without a recent heartbeat, and update `heartbeats`.

    Parameters
    ----------
    records
        The scheduler's records of its workers.
    heartbeats
        Last heartbeat of each worker, and the time at which that heartbeat was first seen; updated.
    now_s
        Seconds of a monotonic clock.
    """
    for address in [address for address in heartbeats if address not in records]:
        del heartbeats[address]
    for address, record in records.items():
        last_s = float(record.get("last_seen", 0.0))
        if address not in heartbeats or heartbeats[address][0] != last_s:
            heartbeats[address] = (last_s, now_s)
    return [address for address in records if now_s - heartbeats[address][1] > _HEARTBEAT_TIMEOUT_S]


def _redirect_log() -> None:
    """Send Dask's messages to the log of this process, in its format, instead of Dask's own handlers."""
    for name in ("distributed", "distributed.client"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
        logger.setLevel(logging.WARNING)


def _ignore_result(cancellation: asyncio.Future[Any]) -> None:
    if not cancellation.cancelled():
        cancellation.exception()
