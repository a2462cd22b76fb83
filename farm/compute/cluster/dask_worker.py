"""Worker of a Dask cluster that runs tasks of farms, in processes of the local pool."""

from __future__ import annotations

import asyncio
from pathlib import Path

from distributed import Security, Worker, get_worker

from farm.compute.cluster.remote_task import RemoteAnswer, RemoteTask
from farm.compute.cluster.task_executor import TaskExecutor

RESOURCE = "farm"
"""Dask resource of which each task uses one unit, so that workers without it get no tasks of a farm."""
TOPIC = "farm-{}"
"""Topic of the messages about the tasks of a client: the host of each task, and its live files."""
_WATCH_INTERVAL_S = 0.2  # wall seconds between two checks that the result of a task is still needed


class FarmWorker(Worker):  # type: ignore[misc]
    """Dask worker with an executor of tasks.

    Parameters
    ----------
    scheduler
        Address of the scheduler.
    executor
        Executor that runs the tasks. Clients compare the versions of its installation with theirs.
    slot_count
        Maximum number of tasks that it runs at the same time.
    folder
        Folder for Dask's files.
    security
        See `make_security`.
    """

    def __init__(
        self,
        scheduler: str,
        executor: TaskExecutor,
        slot_count: int,
        folder: Path,
        security: Security | None = None,
    ) -> None:
        self.farm_executor = executor
        record = executor.installation.as_record()

        async def describe(_: Worker) -> dict[str, str]:
            return record

        super().__init__(
            scheduler,
            nthreads=slot_count,
            resources={RESOURCE: slot_count},
            name=executor.host,
            local_directory=str(folder),
            security=security,
            startup_information={RESOURCE: describe},
            memory_limit=0,  # each process has its own limit
            dashboard=False,
        )


async def run_task(task: RemoteTask, contents: dict[str, bytes], client: str) -> RemoteAnswer:
    """Run a task on the worker that Dask chose; stop the task when its result is no longer needed.

    The result is no longer needed once the task is cancelled, or once its client or the scheduler is gone.
    Dask lets a coroutine continue in these cases.

    Parameters
    ----------
    task
        The task; its id is the key of Dask's task.
    contents
        Contents of the files that were sent with the task, by hash.
    client
        Id of the client, for messages.
    """
    worker = get_worker()

    def report(**message: object) -> None:
        worker.log_event(TOPIC.format(client), {"task": task.id, "host": str(worker.name), **message})

    report()
    execution = asyncio.ensure_future(
        worker.farm_executor.execute(
            task, contents, lambda path, content: report(path=path, content=content.decode(errors="replace"))
        )
    )
    try:
        while not execution.done():
            await asyncio.wait({execution}, timeout=_WATCH_INTERVAL_S)
            state = worker.state.tasks.get(task.id)
            if state is None or state.state == "cancelled":
                break
        if not execution.done():
            return RemoteAnswer(str(worker.name))  # nobody reads this answer
        answer: RemoteAnswer = await execution
        return answer
    finally:
        execution.cancel()
        await asyncio.wait({execution})
