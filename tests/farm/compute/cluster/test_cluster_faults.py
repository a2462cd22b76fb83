"""Killed processes of a cluster with TLS: the work is done once, and nothing is left running."""

import asyncio
import signal
from functools import partial
from pathlib import Path

import pytest

import portable_work as work
from cluster_processes import Processes
from dask_cluster import HERE, Recorder
from farm.compute.cluster import cluster_state, connection
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.cluster_state import Place
from farm.compute.cluster.connection import Connection, list_stuck, list_workers

pytestmark = pytest.mark.system


async def until(condition):
    while not condition():
        await asyncio.sleep(0.02)


def is_gone(pid):
    return not Path(f"/proc/{pid}").exists()


def read_pids(note):
    return [int(pid) for pid in note.read_text().split()] if note.exists() else []


def test_a_killed_worker_and_a_killed_scheduler(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster_state, "PATIENCE_S", 1.0)
    source, note, second = tmp_path / "model.stl", tmp_path / "pids", tmp_path / "second"
    source.write_bytes(b"solid")
    processes = Processes(tmp_path)

    async def main():
        address = await processes.start_scheduler()
        for name in ("w1", "w2"):
            processes.start_worker(name)
        own = Recorder()
        pool = ClusterPool(own, address, HERE, partial(Connection, address, processes.certificates, HERE))
        pool.start()
        await until(lambda: len(pool.state.workers) == 2)
        task = asyncio.ensure_future(pool.run(work.hold_once, source, tmp_path / "out", str(note)))
        await until(lambda: read_pids(note) and pool.state.tasks[0].host)
        processes.send(pool.state.tasks[0].host, signal.SIGKILL)
        assert await task == 2
        await until(lambda: is_gone(read_pids(note)[0]))
        await until(lambda: len(pool.state.workers) == 1)
        task = asyncio.ensure_future(pool.run(work.hold_once, source, tmp_path / "out", str(second)))
        await until(lambda: read_pids(second))
        processes.send("scheduler", signal.SIGKILL)
        assert await task == 2
        assert own.calls == [work.hold_once] and pool.state.place is Place.HERE
        await until(lambda: is_gone(read_pids(second)[0]))
        pool.close()
        await pool.wait_closed()

    try:
        asyncio.run(main())
    finally:
        processes.close()


def test_a_connection_that_is_cancelled_while_it_is_lost_ends(monkeypatch):
    """Dask's client takes long to close when its scheduler is gone."""
    monkeypatch.setattr(connection, "_POLL_S", 0.05)
    closing = asyncio.Event()

    class SlowClient:
        async def close(self, timeout):
            closing.set()
            await asyncio.Event().wait()

    async def lose(self):
        self._client = SlowClient()
        raise OSError("the scheduler is gone")

    async def main():
        monkeypatch.setattr(Connection, "_watch_once", lose)
        link = Connection("tcp://127.0.0.1:1", None, HERE, lambda _: None, lambda _: None)
        watching = asyncio.ensure_future(link.watch())
        await closing.wait()
        watching.cancel()
        await asyncio.wait({watching}, timeout=5.0)
        assert watching.cancelled()

    asyncio.run(main())


def test_a_worker_whose_heartbeat_stands_still_is_stuck():
    heard = {}
    records = {"tls://a": {"last_seen": 100.0}, "tls://b": {"last_seen": 100.0}}
    assert list_stuck(records, heard, 0.0) == [("tls://a", False), ("tls://b", False)]
    records["tls://b"]["last_seen"] = 120.0
    assert list_stuck(records, heard, 20.0) == [("tls://a", False), ("tls://b", False)]
    assert list_stuck(records, heard, 20.5) == [("tls://a", True), ("tls://b", False)]
    del records["tls://a"]
    assert list_stuck(records, heard, 21.0) == [("tls://b", False)] and list(heard) == ["tls://b"]


def test_workers_of_others_are_not_used():
    records = {
        "tls://a": {"name": "a", "nthreads": 4, "farm": HERE.as_record()},
        "tls://b": {"name": "b", "nthreads": 2},
        "tls://c": {"name": "c", "nthreads": 2, "farm": {"farm": "0"}},
    }
    a, c = list_workers(records, HERE)
    assert (a.name, a.slots, a.refused) == ("a", 4, None)
    assert (c.name, c.refused) == ("c", "it has farm 0, not 1")
