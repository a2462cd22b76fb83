"""Worker processes: crashes, time limits, memory limits and cancelled tasks."""

import asyncio
import os
import signal
from functools import partial
from pathlib import Path

import pytest
import trimesh

from clusters import failing_work as work
from farm.compute import DECOMPOSING_LIMIT, Limit, PoolShare
from farm.compute.worker_pool import WorkerPool, compute_worker_memory_bytes
from farm.compute.worker_process import Worker
from farm.errors import ErrorCode, FarmError


class Pool:
    """Pool of worker processes in a folder; each `run` has its own event loop."""

    def __init__(self, scratch):
        self.scratch = scratch

    def run(self, run_scenario, **options):
        """Run `run_scenario(workers)`, and return its result; assert that no process of the pool remains."""

        async def main():
            workers = WorkerPool(self.scratch, **{"count": 1, **options})
            try:
                return await run_scenario(workers)
            finally:
                workers.close()

        answer = asyncio.run(main())
        assert not self.scratch.exists()
        return answer


@pytest.fixture
def pool(tmp_path):
    return Pool(tmp_path / "workers")


def has_ended(pid):
    return not Path(f"/proc/{pid}").exists()


def test_work_of_a_dead_worker_is_repeated(pool, tmp_path):
    assert pool.run(lambda workers: workers.run(work.die_once, tmp_path / "died")) == "alive"


def test_work_that_kills_every_worker_is_reported_and_the_next_runs(pool, tmp_path):
    async def run_scenario(workers):
        match = r"decomposing ended its worker process 2 times \(SIGSEGV\)"
        with pytest.raises(FarmError, match=match) as error:
            await workers.run(work.die, signal.SIGSEGV, limit=DECOMPOSING_LIMIT)
        assert error.value.code is ErrorCode.LIMIT
        return await workers.run(work.get_pid)

    assert has_ended(pool.run(run_scenario))


async def wait_until(condition):
    async with asyncio.timeout(120.0):
        while not condition():
            await asyncio.sleep(0.01)


def test_start_step_is_reported_until_a_worker_is_ready(pool, tmp_path):
    os.mkfifo(tmp_path / "fifo")

    async def run_scenario(workers):
        await wait_until(lambda: workers.start_step == "compiling")
        await asyncio.to_thread((tmp_path / "fifo").write_text, "go on")
        await wait_until(lambda: workers.start_step is None)
        return await workers.run(work.get_pid)

    assert pool.run(run_scenario, warm_up=partial(work.prepare_worker, tmp_path / "fifo", tmp_path / "first"))


def test_work_is_given_to_a_started_worker(pool, tmp_path):
    os.mkfifo(tmp_path / "fifo")

    async def run_scenario(workers):
        await wait_until(lambda: workers.start_step is None)
        return [await workers.run(work.get_pid) for _ in range(3)]

    warm_up = partial(work.prepare_worker, tmp_path / "fifo", tmp_path / "first")
    assert len(set(pool.run(run_scenario, count=2, warm_up=warm_up))) == 1


@pytest.mark.parametrize("ending", ["dies", "is cancelled"])
def test_worker_that_ends_does_not_affect_other_work(pool, tmp_path, ending):
    os.mkfifo(tmp_path / "fifo")

    async def run_scenario(workers):
        other_task = asyncio.ensure_future(workers.run(work.write_line, tmp_path / "fifo", "hello"))
        if ending == "dies":
            with pytest.raises(FarmError, match="2 times"):
                await workers.run(work.die)
        else:
            old_pids = workers.pids
            task = asyncio.ensure_future(workers.run(work.pause))
            await asyncio.sleep(0)  # the task now has its worker
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert len(workers.pids - old_pids) == 1
        assert not other_task.done()  # the task cannot end before the FIFO is read
        assert await asyncio.to_thread((tmp_path / "fifo").read_text) == "hello"
        return await other_task

    # If the task were repeated, the FIFO would have no reader.
    assert pool.run(run_scenario, count=2) == "hello"


def test_error_is_transferred_between_processes_unchanged(pool):
    async def run_scenario(workers):
        with pytest.raises(FarmError, match="no such file") as error:
            await workers.run(work.raise_error)
        assert error.value.code is ErrorCode.FAILED
        assert "in raise_error" in error.value.__notes__[0]
        with pytest.raises(FarmError, match="UnpicklableError: this cannot travel"):
            await workers.run(work.raise_unpicklable_error)

    pool.run(run_scenario)


@pytest.mark.parametrize("ending", ["cancelled", "too long", "closed"])
def test_cancelled_work_leaves_no_process_and_no_file(pool, tmp_path, ending):
    """Detect the end of the engine with a FIFO, which ends when no process holds it open."""
    os.mkfifo(tmp_path / "fifo")

    async def run_scenario(workers):
        limit = Limit("hanging", 0.0 if ending == "too long" else 1000.0)
        old_pids = workers.pids
        task = asyncio.ensure_future(workers.run(work.run_hanging_engine, tmp_path, limit=limit))
        if ending == "too long":
            with pytest.raises(FarmError, match="hanging did not end within 0 min") as error:
                await task
            assert error.value.code is ErrorCode.LIMIT
        else:
            with await asyncio.to_thread((tmp_path / "fifo").open) as fifo:
                engine_pid = int(await asyncio.to_thread(fifo.readline))
                assert not has_ended(engine_pid)
                assert list(pool.scratch.glob("worker-*/farm-engine-*"))
                workers.close() if ending == "closed" else task.cancel()
                with pytest.raises(FarmError if ending == "closed" else asyncio.CancelledError):
                    await task
                assert await asyncio.to_thread(fifo.read) == ""
        assert all(has_ended(pid) for pid in old_pids)
        if ending != "closed":
            # A new worker replaces the old one, and only the new worker's folder exists.
            assert await workers.run(work.get_pid) not in old_pids
            assert list(pool.scratch.iterdir()) == [await workers.run(work.find_temporary_folder)]

    pool.run(run_scenario)


def test_urgent_work_runs_first_and_a_cancelled_task_frees_its_worker(pool, tmp_path):
    for name in ("fifo", "urgent"):
        os.mkfifo(tmp_path / name)
    order = []

    async def run_task(workers, name, urgent):
        await workers.run(work.get_pid, limit=Limit(name, 60.0, urgent))
        order.append(name)

    async def run_scenario(workers):
        busy_task = asyncio.ensure_future(workers.run(work.write_line, tmp_path / "fifo", "hello"))
        await asyncio.sleep(0)
        second_task = asyncio.ensure_future(workers.run(work.write_line, tmp_path / "urgent", "hello"))
        await asyncio.sleep(0)
        tasks = []
        for name, urgent in (("plate 1", False), ("plate 2", False), ("given up", True), ("model", True)):
            tasks.append(asyncio.ensure_future(run_task(workers, name, urgent)))
        await asyncio.sleep(0)  # all of them wait now
        tasks.pop(2).cancel()
        await asyncio.to_thread((tmp_path / "fifo").read_text)
        await asyncio.gather(busy_task, *tasks)
        await asyncio.to_thread((tmp_path / "urgent").read_text)
        await second_task

    pool.run(run_scenario)
    assert order == ["model", "plate 1", "plate 2"]


def test_quick_task_does_not_wait_while_all_workers_are_busy(pool):
    """Plan a dry run, which takes a second, while a model is decomposed for minutes."""

    async def run_scenario(workers):
        long_tasks = [
            asyncio.ensure_future(workers.run(work.pause, limit=DECOMPOSING_LIMIT)) for _ in range(2)
        ]
        await asyncio.sleep(0)
        assert len(workers.pids) == 1  # the second task waits
        first_pid = await PoolShare(workers, "dry run", is_urgent=True).run(
            work.get_pid, limit=DECOMPOSING_LIMIT
        )
        assert await workers.run(work.get_pid) == first_pid in workers.pids
        with pytest.raises(FarmError, match="2 times"):
            await workers.run(work.die)
        assert await workers.run(work.get_pid) != first_pid
        assert len(workers.pids) == 2
        assert not any(task.done() for task in long_tasks)
        for task in long_tasks:
            task.cancel()
        await asyncio.gather(*long_tasks, return_exceptions=True)

    pool.run(run_scenario)


def test_all_work_is_refused_once_the_pool_is_closed(pool):
    """Close the pool while one model is checked and another one waits for a worker."""

    async def run_scenario(workers):
        tasks = [asyncio.ensure_future(workers.run(work.pause, limit=DECOMPOSING_LIMIT)) for _ in range(2)]
        await asyncio.sleep(0)
        workers.close()
        for task in (*tasks, asyncio.ensure_future(workers.run(work.get_pid))):
            with pytest.raises(FarmError, match="shutting down"):
                await task

    pool.run(run_scenario)


def test_groups_share_the_workers_evenly(pool, tmp_path):
    """Check that a job with many parts does not delay the next job."""
    for name in ("one", "two"):
        os.mkfifo(tmp_path / name)
    order = []

    async def run_task(workers, group):
        await PoolShare(workers, group).run(work.get_pid, limit=DECOMPOSING_LIMIT)
        order.append(group)

    async def run_scenario(workers):
        large_share, small_share = PoolShare(workers, "big"), PoolShare(workers, "small")
        busy_tasks = [
            asyncio.ensure_future(
                large_share.run(work.write_line, tmp_path / name, "hello", limit=DECOMPOSING_LIMIT)
            )
            for name in ("one", "two")
        ]
        tasks = [asyncio.ensure_future(run_task(workers, group)) for group in ("big", "big", "small")]
        await asyncio.sleep(0)
        await asyncio.to_thread((tmp_path / "one").read_text)
        await asyncio.gather(*tasks)
        assert await small_share.run(work.find_temporary_folder, limit=DECOMPOSING_LIMIT)
        await asyncio.to_thread((tmp_path / "two").read_text)
        await asyncio.gather(*busy_tasks)

    pool.run(run_scenario, count=2)
    assert order == ["small", "big", "big"]


def test_oversized_model_ends_with_advice(pool):
    async def run_scenario(workers):
        assert await workers.run(work.allocate_memory, 0.1) > 10**8
        with pytest.raises(FarmError, match=r"not enough memory for decomposing \(.* 2.0 GB\)") as error:
            await workers.run(work.allocate_memory, 3.0, limit=DECOMPOSING_LIMIT)
        assert error.value.code is ErrorCode.LIMIT
        assert await workers.run(work.read_oom_score) > work.read_oom_score()
        return await workers.run(work.allocate_memory, 0.1)

    assert pool.run(run_scenario, memory_gb=2.0) > 10**8


def test_failed_worker_start_is_retried(pool, monkeypatch):
    class FullDiskWorker(Worker):
        remaining_successes = 2

        def __init__(self, *arguments):
            FullDiskWorker.remaining_successes -= 1
            if FullDiskWorker.remaining_successes >= 0:
                raise OSError("no space left")
            super().__init__(*arguments)

    async def run_scenario(workers):
        monkeypatch.setattr("farm.compute.worker_pool.Worker", FullDiskWorker)
        monkeypatch.setattr("farm.compute.worker_pool._RETRY_INTERVAL_S", 0.0)
        with pytest.raises(FarmError, match="2 times"):
            await workers.run(work.die)
        return await workers.run(work.get_pid)

    assert pool.run(run_scenario) > 0
    assert FullDiskWorker.remaining_successes < 0


def test_engine_is_not_bound_by_the_memory_limit_of_its_worker(pool, tmp_path):
    """Run an engine that reserves 9 MB for each of 300 layers, and uses almost none of it."""
    trimesh.creation.box((8.0, 8.0, 60.0)).export(tmp_path / "rod.stl")

    async def run_scenario(workers):
        return await workers.run(work.slice_rod, tmp_path)

    assert pool.run(run_scenario, memory_gb=1.0) == 300


def test_memory_of_a_worker_is_its_share_or_the_minimum():
    machine_bytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert compute_worker_memory_bytes(1, None) == pytest.approx(0.8 * machine_bytes)
    assert compute_worker_memory_bytes(10_000, None) == min(4 * 2**30, machine_bytes // 2)
    assert compute_worker_memory_bytes(8, 1.5) == 1.5 * 2**30


def test_pool_is_idle_while_a_worker_is_free_for_any_task(pool):
    async def run_scenario(workers):
        idle_states = [workers.has_idle_worker]
        task = asyncio.ensure_future(workers.run(work.get_pid, limit=DECOMPOSING_LIMIT))
        await asyncio.sleep(0)
        idle_states.append(workers.has_idle_worker)
        await task
        return [*idle_states, workers.has_idle_worker]

    assert pool.run(run_scenario) == [True, False, True]
