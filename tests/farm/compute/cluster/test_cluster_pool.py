"""Tasks on a Dask cluster in this process: files, versions, errors, cancelled tasks, lost workers."""

import asyncio
import logging
from dataclasses import replace

import pytest

from clusters import portable_work as work
from clusters.dask_cluster import INSTALLATION, RecordingPool, run_cluster
from farm.compute import Limit, WorkerPool
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.cluster_state import ClusterWorker, Place
from farm.compute.cluster.remote_task import AttemptLost, RemoteAnswer, RemoteTask, write_files
from farm.compute.cluster.task_executor import TaskExecutor
from farm.compute.limits import CHECKING_LIMIT
from farm.errors import ErrorCode, FarmError


def run(run_scenario, *args, **options):
    """Run `run_scenario(pool, scheduler)` with a cluster."""

    async def main():
        async with run_cluster(*args, **options) as (pool, scheduler):
            return await run_scenario(pool, scheduler)

    return asyncio.run(main())


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "model.stl"
    path.write_bytes(b"solid" * 1000)
    return path


def test_files_go_to_workers_and_come_back(tmp_path, source):
    """Send files again to a worker that has lost them, and only to workers with the right versions."""
    path, folder = tmp_path / "out", tmp_path / "cluster"
    old_installation = replace(INSTALLATION, engine="5.0")

    async def run_scenario(pool, scheduler):
        first_result = await pool.run(work.copy, source, path / "1")
        (cached_file,) = (folder / "w1" / "files").iterdir()
        cached_file.unlink()
        second_result = await pool.run(work.copy, source, path / "2")
        with pytest.raises(FarmError, match="this model is hollow"):
            await pool.run(work.fail, source, path / "3")
        assert pool.state.place is Place.CLUSTER and pool.recording_pool.calls == []
        assert await pool.run(len, "here") == 4 and pool.recording_pool.calls == [len]
        assert pool.state.list_problems() == [
            "worker w2 of the cluster is refused: it has CuraEngine 5.0, not 4.13"
        ]
        return first_result, second_result

    first_host, second_host = run(run_scenario, folder, ["w1", "w2"], installations={"w2": old_installation})
    assert second_host["copy"] == path / "2" / "copy.txt"
    assert second_host["copy"].read_bytes() == first_host["copy"].read_bytes() == source.read_bytes()
    assert (path / "2" / "deep" / "size.txt").read_text() == "5000"
    assert str(first_host["elsewhere"]) == "/elsewhere/file"
    assert list((folder / "w1" / "tasks").iterdir()) == []
    assert not (folder / "w2" / "files").exists() or not list((folder / "w2" / "files").iterdir())


def test_task_for_workers_that_left_goes_to_others(tmp_path, source):
    """Reassign a task that Dask keeps for the addresses of workers, which return with other addresses."""

    async def run_scenario(pool, scheduler):
        pool._connection._workers = (ClusterWorker("w1", "tcp://127.0.0.1:1", 1),)
        async with asyncio.timeout(300):
            return await pool.run(work.copy, source, tmp_path / "out")

    answer = run(run_scenario, tmp_path / "cluster", ["w1"])
    assert answer["copy"].read_bytes() == source.read_bytes()


def run_in_processes(tmp_path, run_scenario, **options):
    """Run `run_scenario(pool, processes)` with a worker that runs tasks in processes."""

    async def main():
        processes = WorkerPool(tmp_path / "processes", 1, **options)
        try:
            async with run_cluster(tmp_path / "cluster", ["w1"], pools={"w1": processes}) as (pool, _):
                await run_scenario(pool, processes)
        finally:
            processes.close()

    asyncio.run(main())


def test_cancelled_task_ends_its_process_on_the_worker(tmp_path, source):
    pid_file, path = tmp_path / "pids", tmp_path / "out"

    async def run_scenario(pool, processes):
        task = asyncio.ensure_future(pool.run(work.hold, source, path, str(pid_file)))
        while not (path / "progress.json").exists():  # a progress file, which the worker sends
            await asyncio.sleep(0.02)
        assert [run_task.host for run_task in pool.state.tasks] == ["w1"] and not pool.has_idle_worker
        (pid,) = map(int, pid_file.read_text().split())
        assert pid in processes.pids
        task.cancel()
        while pid in processes.pids:
            await asyncio.sleep(0.02)
        with pytest.raises(asyncio.CancelledError):
            await task
        assert pool.state.tasks == () and pool.has_idle_worker

    run_in_processes(tmp_path, run_scenario)


def test_limits_of_a_task_hold_on_the_worker(tmp_path, source):
    """Check that limits of time and memory give the usual messages, and that the worker continues."""
    pid_file, path = tmp_path / "pids", tmp_path / "out"

    async def run_scenario(pool, processes):
        (pid,) = processes.pids
        with pytest.raises(FarmError, match="holding did not end within") as error:
            await pool.run(work.hold, source, path, str(pid_file), limit=Limit("holding", 1.0))
        with pytest.raises(FarmError, match=r"not enough memory for allocating .* 0\.5 GB") as memory_error:
            await pool.run(work.allocate, source, path, 2.0, limit=Limit("allocating", 60.0))
        assert error.value.code is memory_error.value.code is ErrorCode.LIMIT
        assert (await pool.run(work.copy, source, path))["copy"].exists()
        assert pid not in processes.pids and pool.recording_pool.calls == []

    run_in_processes(tmp_path, run_scenario, memory_gb=0.5)


class LossyConnection:
    """Connection to a cluster whose workers the test sets, and which loses every task."""

    def __init__(self, on_workers, _):
        self.on_workers, self.tasks = on_workers, []

    async def watch(self):
        await asyncio.Event().wait()

    async def submit(self, task, files):
        self.tasks.append((task.id, sorted(files)))
        if len(self.tasks) > 1:
            raise AttemptLost("worker w1 is gone")
        await asyncio.Event().wait()


def test_work_continues_on_this_computer_when_the_cluster_is_silent_for_half_a_minute(
    tmp_path, source, caplog
):
    """Abandon the task in progress, and send later ones to the cluster once it has a worker."""
    now_s = 0.0

    async def main():
        nonlocal now_s
        connections, local_pool = [], RecordingPool()
        pool = ClusterPool(
            local_pool,
            "tls://a:1",
            INSTALLATION,
            lambda *args: connections.append(LossyConnection(*args)) or connections[0],
            lambda: now_s,
        )
        (connection,), workers = connections, (ClusterWorker("w1", "tls://b:1", 1),)
        caplog.set_level(logging.INFO, "farm.compute.cluster.cluster_pool")
        connection.on_workers(workers)
        run_task = asyncio.ensure_future(pool.run(work.copy, source, tmp_path / "out"))
        while not connection.tasks:
            await asyncio.sleep(0.01)
        connection.on_workers(())
        now_s = 29.0
        connection.on_workers(())
        assert pool.state.place is Place.WAITING and not run_task.done()
        now_s = 31.0
        connection.on_workers(())
        assert (await run_task)["copy"].exists()
        assert local_pool.calls == [work.copy] and pool.state.place is Place.THIS_COMPUTER
        assert "running on this computer instead" in pool.state.list_problems()[0]
        connection.on_workers(workers)
        assert pool.state.place is Place.CLUSTER and pool.state.list_problems() == []
        await pool.run(work.copy, source, tmp_path / "again")  # lost three times, then run on this computer
        assert len(local_pool.calls) == 2 and len(connection.tasks) == 4
        assert len({name for name, _ in connection.tasks}) == 4
        scheduler, notices = pool.state.scheduler, [(r.levelname, r.message) for r in caplog.records]
        assert ("WARNING", f"no worker of {scheduler} can be used: tasks wait for one") in notices
        assert [level for level, text in notices if text == f"tasks run on the workers of {scheduler}"] == [
            "INFO"
        ] * 2

    asyncio.run(main())


class FullDiskConnection(LossyConnection):
    """Connection to a cluster whose only worker has a full disk."""

    async def submit(self, task, files):
        self.tasks.append(sorted(files.values()))
        return RemoteAnswer("w1", mismatch="No space left on device")


def test_task_that_no_worker_can_run_is_run_on_this_computer(tmp_path, source):
    async def main():
        connections, local_pool = [], RecordingPool()
        pool = ClusterPool(
            local_pool,
            "tls://a:1",
            INSTALLATION,
            lambda *args: connections.append(FullDiskConnection(*args)) or connections[0],
        )
        connections[0].on_workers((ClusterWorker("w1", "tls://b:1", 1),))
        assert (await pool.run(work.copy, source, tmp_path / "out"))["copy"].exists()
        assert local_pool.calls == [work.copy] and connections[0].tasks == [[source.read_bytes()], [], []]

    asyncio.run(main())


@pytest.mark.parametrize(
    "files", [{"0" * 64: b"other bytes"}, {}], ids=["damaged in transit", "of another version"]
)
def test_worker_refuses_damaged_files_and_other_versions(tmp_path, files):
    async def main():
        executor = TaskExecutor("w1", tmp_path, RecordingPool(), INSTALLATION)
        installation = INSTALLATION if files else replace(INSTALLATION, settings="other")
        return await executor.execute(RemoteTask("t", b"", CHECKING_LIMIT, installation), files)

    answer = asyncio.run(main())
    assert answer.mismatch == (
        "the file 000000000000 was damaged in transit" if files else "it has Cura's settings abc, not other"
    )


@pytest.mark.parametrize("name", ["/etc/passwd", "/farm/job-1/../other", "/farm/job-10/p.stl", "/farm/job-1"])
def test_worker_writes_only_files_of_its_task(name):
    task = RemoteTask("t", b"", CHECKING_LIMIT, INSTALLATION, output_folders=("/farm/job-1",))
    with pytest.raises(ValueError, match="not a file of its task"):
        write_files(task, RemoteAnswer("w", files={name: b"x"}).files)
