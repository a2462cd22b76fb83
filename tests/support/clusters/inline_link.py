"""A cluster of one worker in the process of a test."""

import asyncio

from farm.compute.cluster.cluster_state import ClusterWorker


class InlineLink:
    """Link to an executor; see `cluster_pool.Link`."""

    def __init__(self, executor, on_workers):
        self._executor, self._on_workers = executor, on_workers

    async def watch(self):
        self._on_workers((ClusterWorker("w1", "tls://w1", 1),))
        await asyncio.Event().wait()

    async def submit(self, task, files):
        return await self._executor.execute(task, files)
