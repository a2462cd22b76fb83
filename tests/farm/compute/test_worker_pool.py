"""Worker processes: crashes, time limits, memory limits and cancelled tasks."""

import asyncio
import os
import signal
from functools import partial
from pathlib import Path

import pytest
import trimesh

import failing_work as work
from farm.compute import DECOMPOSING, Limit, PoolShare
from farm.compute.worker_pool import Workers, compute_memory_for_each
from farm.compute.worker_process import Worker
from farm.errors import ErrorCode, FarmError


class Pool:
    """A pool on a folder; each `run` is an event loop of its own."""

    def __init__(self, scratch):
        self.scratch = scratch

    def run(self, use, **options):
        """Run `use(workers)`, and return its result; assert that nothing of the pool is left."""

        async def main():
            workers = Workers(self.scratch, **{"count": 1, **options})
            try:
                return await use(workers)
            finally:
                workers.close()

        answer = asyncio.run(main())
        assert not self.scratch.exists()
        return answer


@pytest.fixture
def pool(tmp_path):
    return Pool(tmp_path / "workers")


def gone(pid):
    return not Path(f"/proc/{pid}").exists()


def test_work_of_a_dead_worker_is_repeated(pool, tmp_path):
    assert pool.run(lambda workers: workers.run(work.die_once, tmp_path / "died")) == "alive"


def test_work_that_kills_every_worker_is_reported_and_the_next_runs(pool, tmp_path):
    async def use(workers):
        with pytest.raises(FarmError, match=r"decomposing ended its worker process 2 times \(SIGSEGV\)"):
            await workers.run(work.die, signal.SIGSEGV, limit=DECOMPOSING)
        return await workers.run(work.whoami)

    assert gone(pool.run(use))


async def until(condition):
    async with asyncio.timeout(120.0):
        while not condition():
            await asyncio.sleep(0.01)


def test_start_step_is_reported_until_a_worker_is_ready(pool, tmp_path):
    os.mkfifo(tmp_path / "fifo")

    async def use(workers):
        await until(lambda: workers.starting == "compiling")
        await asyncio.to_thread((tmp_path / "fifo").write_text, "go on")
        await until(lambda: workers.starting is None)
        return await workers.run(work.whoami)

    assert pool.run(use, warm=partial(work.start_after, tmp_path / "fifo", tmp_path / "first"))


def test_work_is_given_to_a_started_worker(pool, tmp_path):
    os.mkfifo(tmp_path / "fifo")

    async def use(workers):
        await until(lambda: workers.starting is None)
        return [await workers.run(work.whoami) for _ in range(3)]

    warm = partial(work.start_after, tmp_path / "fifo", tmp_path / "first")
    assert len(set(pool.run(use, count=2, warm=warm))) == 1


@pytest.mark.parametrize("ending", ["dies", "is cancelled"])
def test_worker_that_ends_does_not_affect_other_work(pool, tmp_path, ending):
    os.mkfifo(tmp_path / "fifo")

    async def use(workers):
        other = asyncio.ensure_future(workers.run(work.speak, tmp_path / "fifo", "hello"))
        if ending == "dies":
            with pytest.raises(FarmError, match="2 times"):
                await workers.run(work.die)
        else:
            before = workers.pids
            task = asyncio.ensure_future(workers.run(work.pause))
            await asyncio.sleep(0)  # it has its worker now
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert len(workers.pids - before) == 1
        assert not other.done()  # it cannot end before somebody listens
        assert await asyncio.to_thread((tmp_path / "fifo").read_text) == "hello"
        return await other

    # Were it done again after an end, nobody would listen any more.
    assert pool.run(use, count=2) == "hello"


def test_error_is_transferred_between_processes_unchanged(pool):
    async def use(workers):
        with pytest.raises(FarmError, match="no such thing") as error:
            await workers.run(work.raise_error)
        assert error.value.code is ErrorCode.FAILED
        assert "in raise_error" in error.value.__notes__[0]
        with pytest.raises(FarmError, match="UnpicklableError: this cannot travel"):
            await workers.run(work.raise_unpicklable_error)

    pool.run(use)


@pytest.mark.parametrize("ending", ["cancelled", "too long", "closed"])
def test_cancelled_work_leaves_no_process_and_no_file(pool, tmp_path, ending):
    """The engine holds a FIFO open: its end is read when nobody runs it any more."""
    os.mkfifo(tmp_path / "fifo")

    async def use(workers):
        limit = Limit("hanging", 0.0 if ending == "too long" else 1000.0)
        before = workers.pids
        task = asyncio.ensure_future(workers.run(work.hang, tmp_path, limit=limit))
        if ending == "too long":
            with pytest.raises(FarmError, match="hanging did not end within 0 min") as error:
                await task
            assert error.value.code is ErrorCode.LIMIT
        else:
            with await asyncio.to_thread((tmp_path / "fifo").open) as fifo:
                engine = int(await asyncio.to_thread(fifo.readline))
                assert not gone(engine)
                assert list(pool.scratch.glob("worker-*/farm-engine-*"))
                workers.close() if ending == "closed" else task.cancel()
                with pytest.raises(FarmError if ending == "closed" else asyncio.CancelledError):
                    await task
                assert await asyncio.to_thread(fifo.read) == ""
        assert all(gone(pid) for pid in before)
        if ending != "closed":
            # A fresh worker takes its place, and only its folder is there.
            assert await workers.run(work.whoami) not in before
            assert list(pool.scratch.iterdir()) == [await workers.run(work.temporary_folder)]

    pool.run(use)


def test_urgent_work_runs_first_and_a_cancelled_task_frees_its_worker(pool, tmp_path):
    for name in ("fifo", "urgent"):
        os.mkfifo(tmp_path / name)
    order = []

    async def run_one(workers, name, urgent):
        await workers.run(work.whoami, limit=Limit(name, 60.0, urgent))
        order.append(name)

    async def use(workers):
        busy = asyncio.ensure_future(workers.run(work.speak, tmp_path / "fifo", "hello"))
        await asyncio.sleep(0)
        also_busy = asyncio.ensure_future(workers.run(work.speak, tmp_path / "urgent", "hello"))
        await asyncio.sleep(0)
        tasks = []
        for name, urgent in (("plate 1", False), ("plate 2", False), ("given up", True), ("model", True)):
            tasks.append(asyncio.ensure_future(run_one(workers, name, urgent)))
        await asyncio.sleep(0)  # all of them wait now
        tasks.pop(2).cancel()
        await asyncio.to_thread((tmp_path / "fifo").read_text)
        await asyncio.gather(busy, *tasks)
        await asyncio.to_thread((tmp_path / "urgent").read_text)
        await also_busy

    pool.run(use)
    assert order == ["model", "plate 1", "plate 2"]


def test_quick_task_does_not_wait_while_all_workers_are_busy(pool):
    """A model is decomposed for minutes; the dry run of another file takes a second."""

    async def use(workers):
        long = [asyncio.ensure_future(workers.run(work.pause, limit=DECOMPOSING)) for _ in range(2)]
        await asyncio.sleep(0)
        assert len(workers.pids) == 1  # the second waits
        first = await PoolShare(workers, "dry run", urgent=True).run(work.whoami, limit=DECOMPOSING)
        assert await workers.run(work.whoami) == first in workers.pids
        with pytest.raises(FarmError, match="2 times"):
            await workers.run(work.die)
        assert await workers.run(work.whoami) != first
        assert len(workers.pids) == 2
        assert not any(task.done() for task in long)
        for task in long:
            task.cancel()
        await asyncio.gather(*long, return_exceptions=True)

    pool.run(use)


def test_all_work_is_refused_once_the_pool_is_closed(pool):
    """A model that is being checked, and one that waits for a worker, while the daemon ends."""

    async def use(workers):
        tasks = [asyncio.ensure_future(workers.run(work.pause, limit=DECOMPOSING)) for _ in range(2)]
        await asyncio.sleep(0)
        workers.close()
        for task in (*tasks, asyncio.ensure_future(workers.run(work.whoami))):
            with pytest.raises(FarmError, match="shutting down"):
                await task

    pool.run(use)


def test_groups_share_the_workers_evenly(pool, tmp_path):
    """A job with many parts to slice does not keep the next job waiting."""
    for name in ("one", "two"):
        os.mkfifo(tmp_path / name)
    order = []

    async def run_one(workers, group):
        await PoolShare(workers, group).run(work.whoami, limit=DECOMPOSING)
        order.append(group)

    async def use(workers):
        big, small = PoolShare(workers, "big"), PoolShare(workers, "small")
        busy = [
            asyncio.ensure_future(big.run(work.speak, tmp_path / name, "hello", limit=DECOMPOSING))
            for name in ("one", "two")
        ]
        tasks = [asyncio.ensure_future(run_one(workers, group)) for group in ("big", "big", "small")]
        await asyncio.sleep(0)
        await asyncio.to_thread((tmp_path / "one").read_text)
        await asyncio.gather(*tasks)
        assert await small.run(work.temporary_folder, limit=DECOMPOSING)
        await asyncio.to_thread((tmp_path / "two").read_text)
        await asyncio.gather(*busy)

    pool.run(use, count=2)
    assert order == ["small", "big", "big"]


def test_oversized_model_ends_with_advice(pool):
    async def use(workers):
        assert await workers.run(work.allocate_memory, 0.1) > 10**8
        with pytest.raises(FarmError, match=r"not enough memory for decomposing \(.* 2.0 GB\)") as error:
            await workers.run(work.allocate_memory, 3.0, limit=DECOMPOSING)
        assert error.value.code is ErrorCode.LIMIT
        assert await workers.run(work.read_oom_score) > work.read_oom_score()
        return await workers.run(work.allocate_memory, 0.1)

    assert pool.run(use, memory_gb=2.0) > 10**8


def test_failed_worker_start_is_retried(pool, monkeypatch):
    class FullDisk(Worker):
        left = 2

        def __init__(self, *arguments):
            FullDisk.left -= 1
            if FullDisk.left >= 0:
                raise OSError("no space left")
            super().__init__(*arguments)

    async def use(workers):
        monkeypatch.setattr("farm.compute.worker_pool.Worker", FullDisk)
        monkeypatch.setattr("farm.compute.worker_pool._RETRY_S", 0.0)
        with pytest.raises(FarmError, match="2 times"):
            await workers.run(work.die)
        return await workers.run(work.whoami)

    assert pool.run(use) > 0
    assert FullDisk.left < 0


def test_engine_is_not_bound_by_the_memory_limit_of_its_worker(pool, tmp_path):
    """The engine reserves 9 MB for each of 300 layers, and uses almost none of it."""
    trimesh.creation.box((8.0, 8.0, 60.0)).export(tmp_path / "rod.stl")

    async def use(workers):
        return await workers.run(work.slice_rod, tmp_path)

    assert pool.run(use, memory_gb=1.0) == 300


def test_memory_of_a_worker_is_its_share_or_the_minimum():
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert compute_memory_for_each(1, None) == pytest.approx(0.8 * machine)
    assert compute_memory_for_each(10_000, None) == min(4 * 2**30, machine // 2)
    assert compute_memory_for_each(8, 1.5) == 1.5 * 2**30


def test_a_pool_is_idle_while_a_worker_is_free_for_any_task(pool):
    async def use(workers):
        seen = [workers.has_idle]
        running = asyncio.ensure_future(workers.run(work.whoami, limit=DECOMPOSING))
        await asyncio.sleep(0)
        seen.append(workers.has_idle)
        await running
        return [*seen, workers.has_idle]

    assert pool.run(use) == [True, False, True]
