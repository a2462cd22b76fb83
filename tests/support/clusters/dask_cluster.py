"""A Dask cluster in the process of a test."""

import asyncio
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial

from distributed import Scheduler

from clusters.same_process import SameProcess
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.connection import Connection
from farm.compute.cluster.dask_worker import FarmWorker
from farm.compute.cluster.installation import Installation
from farm.compute.cluster.task_executor import TaskExecutor

INSTALLATION = Installation("1", "4.13", "abc", "numpy 2", "", "", "")


class RecordingPool:
    """Local pool that runs each task immediately and records it."""

    start_step = None
    has_idle_worker = True
    memory_bytes = 2**30

    def __init__(self):
        self.calls = []

    async def run(self, work, *args, limit=None, group=None):
        self.calls.append(work)
        return work(*args)

    def close(self):
        pass


@asynccontextmanager
async def run_cluster(folder, workers, pools=None, installations=None):
    """Run a scheduler and workers with these names; yield a connected pool and the scheduler."""
    pools = pools or {}
    async with AsyncExitStack() as stack:
        scheduler = await stack.enter_async_context(
            Scheduler(host="127.0.0.1", port=0, dashboard_address="127.0.0.1:0")
        )
        for name in workers:
            worker_folder = folder / name
            worker_folder.mkdir(parents=True)
            installation = (installations or {}).get(name, INSTALLATION)
            executor = TaskExecutor(name, worker_folder, pools.get(name, SameProcess()), installation)
            worker = FarmWorker(scheduler.address, executor, 1, worker_folder / "dask")
            await stack.enter_async_context(worker)
        local_pool = RecordingPool()
        make_link = partial(Connection, scheduler.address, None, INSTALLATION)
        pool = ClusterPool(local_pool, scheduler.address, INSTALLATION, make_link)
        pool.recording_pool = local_pool  # type: ignore[attr-defined]  # lets a test read its calls
        pool.start()
        while len(pool.state.workers) < len(workers):
            await asyncio.sleep(0.02)
        try:
            yield pool, scheduler
        finally:
            pool.close()
            await pool.wait_closed()
