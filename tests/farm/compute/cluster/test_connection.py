"""Connection to a scheduler: its end, and its usable workers."""

import asyncio

from clusters.dask_cluster import INSTALLATION
from farm.compute.cluster import connection
from farm.compute.cluster.connection import Connection, list_silent_workers, list_workers


def test_connection_can_be_cancelled_while_it_closes_after_a_loss(monkeypatch):
    """Cancel the connection while Dask's client closes, which takes long without its scheduler."""
    monkeypatch.setattr(connection, "_POLL_INTERVAL_S", 0.05)
    is_closing = asyncio.Event()

    class SlowClient:
        async def close(self, timeout):
            is_closing.set()
            await asyncio.Event().wait()

    async def lose_scheduler(self):
        self._client = SlowClient()
        raise OSError("the scheduler is gone")

    async def main():
        monkeypatch.setattr(Connection, "_watch_once", lose_scheduler)
        link = Connection("tcp://127.0.0.1:1", None, INSTALLATION, lambda _: None, lambda _: None)
        watch_task = asyncio.ensure_future(link.watch())
        await is_closing.wait()
        watch_task.cancel()
        await asyncio.wait({watch_task}, timeout=5.0)
        assert watch_task.cancelled()

    asyncio.run(main())


def test_worker_without_new_heartbeats_is_reported_as_stuck():
    heartbeats = {}
    records = {"tls://a": {"last_seen": 100.0}, "tls://b": {"last_seen": 100.0}}
    assert list_silent_workers(records, heartbeats, 0.0) == [] and list(heartbeats) == ["tls://a", "tls://b"]
    records["tls://b"]["last_seen"] = 120.0
    assert list_silent_workers(records, heartbeats, 20.0) == []
    assert list_silent_workers(records, heartbeats, 20.5) == ["tls://a"]
    del records["tls://a"]
    assert list_silent_workers(records, heartbeats, 21.0) == [] and list(heartbeats) == ["tls://b"]


def test_workers_of_other_programs_are_ignored():
    records = {
        "tls://a": {"name": "a", "nthreads": 4, "farm": INSTALLATION.as_record()},
        "tls://b": {"name": "b", "nthreads": 2},
        "tls://c": {"name": "c", "nthreads": 2, "farm": {"farm": "0"}},
    }
    a, c = list_workers(records, INSTALLATION)
    assert (a.name, a.slot_count, a.refusal_reason) == ("a", 4, None)
    assert (c.name, c.refusal_reason) == ("c", "it has farm 0, not 1")
