"""Killed processes of a cluster with TLS: each task is done once, and no process remains."""

import asyncio
import signal
from functools import partial
from pathlib import Path

import pytest

from clusters import portable_work as work
from clusters.cluster_processes import ClusterProcesses
from clusters.dask_cluster import INSTALLATION, RecordingPool
from farm.compute.cluster import cluster_state
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.cluster_state import Place
from farm.compute.cluster.connection import Connection

pytestmark = pytest.mark.system


async def wait_until(condition):
    while not condition():
        await asyncio.sleep(0.02)


def is_gone(pid):
    return not Path(f"/proc/{pid}").exists()


def read_pids(pid_file):
    return [int(pid) for pid in pid_file.read_text().split()] if pid_file.exists() else []


def test_tasks_survive_a_killed_worker_and_a_killed_scheduler(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster_state, "WORKER_TIMEOUT_S", 1.0)
    source, pid_file, second_pid_file = tmp_path / "model.stl", tmp_path / "pids", tmp_path / "second"
    source.write_bytes(b"solid")
    processes = ClusterProcesses(tmp_path)

    async def main():
        address = await processes.start_scheduler()
        for name in ("w1", "w2"):
            processes.start_worker(name)
        local_pool = RecordingPool()
        pool = ClusterPool(
            local_pool,
            address,
            INSTALLATION,
            partial(Connection, address, processes.certificates, INSTALLATION),
        )
        pool.start()
        await wait_until(lambda: len(pool.state.workers) == 2)
        task = asyncio.ensure_future(pool.run(work.hold_once, source, tmp_path / "out", str(pid_file)))
        await wait_until(lambda: read_pids(pid_file) and pool.state.tasks[0].host)
        processes.send_signal(pool.state.tasks[0].host, signal.SIGKILL)
        assert await task == 2
        await wait_until(lambda: is_gone(read_pids(pid_file)[0]))
        await wait_until(lambda: len(pool.state.workers) == 1)
        task = asyncio.ensure_future(pool.run(work.hold_once, source, tmp_path / "out", str(second_pid_file)))
        await wait_until(lambda: read_pids(second_pid_file))
        processes.send_signal("scheduler", signal.SIGKILL)
        assert await task == 2
        assert local_pool.calls == [work.hold_once] and pool.state.place is Place.THIS_COMPUTER
        await wait_until(lambda: is_gone(read_pids(second_pid_file)[0]))
        pool.close()
        await pool.wait_closed()

    try:
        asyncio.run(main())
    finally:
        processes.close()
