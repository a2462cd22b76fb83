"""Service of a worker that cannot join its cluster."""

import asyncio

from farm.compute.cluster import worker_service


class RefusedWorker:
    """Worker whose start fails, as Dask reports it."""

    name = "w1"

    def __await__(self):
        raise RuntimeError("FarmWorker failed to start.") from OSError("certificate verify failed")
        yield

    async def close(self, reason):
        self.reason = reason


def test_worker_that_cannot_join_logs_the_reason(caplog):
    worker = RefusedWorker()
    asyncio.run(worker_service._serve_once(worker, asyncio.Event()))
    assert caplog.messages == ["worker w1: certificate verify failed"]
    assert worker.reason == "the scheduler is gone"
