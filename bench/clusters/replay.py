"""Replay of recorded jobs on simulated workers whose tasks only sleep, through Dask's real scheduler.

Scheduler, workers and farm share one process and one core, so the cost of a task is an upper bound. Work that
Dask does for each worker apart from its tasks (a thread that samples its stack, ticks of its event loop,
readings of the computer's load) is turned off, because real workers do it on their own computers.
"""

from __future__ import annotations

import asyncio
import logging
import statistics
import time
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import dask
from distributed import Scheduler

from clusters.dask_cluster import INSTALLATION, RecordingPool
from farm.compute import DeferredFunction, Limit, TaskFiles
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.connection import Connection
from farm.compute.cluster.dask_worker import FarmWorker
from farm.compute.cluster.relocation import dump, load
from farm.compute.cluster.remote_task import RemoteAnswer, RemoteTask

DISABLED_MONITORING = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "10s",
    "distributed.admin.system-monitor.interval": "60s",
}
LIMIT = Limit("sleeping", 600.0)


class SleepingExecutor:
    """Executor whose tasks sleep; see `TaskExecutor`."""

    installation = INSTALLATION

    def __init__(self, host: str) -> None:
        self.host = host

    async def execute(self, task: RemoteTask, *_: object) -> RemoteAnswer:
        """Sleep for the seconds of the task."""
        _, (seconds,) = load(task.call)
        await asyncio.sleep(seconds)
        return RemoteAnswer(self.host, result=dump(None))


class TimedConnection(Connection):
    """Connection that records the overhead of each task: the seconds that it takes beyond its sleep."""

    def __init__(self, overhead_s: list[float], *args: Any) -> None:
        super().__init__(*args)
        self._overhead_s = overhead_s

    async def submit(self, task: RemoteTask, files: dict[str, bytes]) -> RemoteAnswer:
        """Run a task; see `Connection.submit`."""
        begin_s = time.monotonic()
        answer = await super().submit(task, files)
        _, (seconds,) = load(task.call)
        self._overhead_s.append(time.monotonic() - begin_s - seconds)
        return answer


def _list_no_files(_: float) -> TaskFiles:
    return TaskFiles()


deferred_sleep = DeferredFunction("time:sleep", _list_no_files)


Stages = list[dict[str, list[float]]]
PICTURES, PAGE = ("draw_overview", "draw_step_range"), "draw_job_parts"
DRAWINGS = (*PICTURES, PAGE)
get_seconds = itemgetter(1)


def find_critical_path(stages: Stages, single_drawer: bool = False) -> list[tuple[str, float]]:
    """Find the longest chain of a job's tasks on an unlimited number of workers, with their seconds.

    Parameters
    ----------
    stages
        See `bench.clusters.jobs.list_stages`.
    single_drawer
        True if one worker makes all drawings of a job.
    """
    path: list[tuple[str, float]] = []
    drawing_path: list[tuple[str, float]] = []
    for stage in stages:
        path_before = list(path)
        path += [(kind, max(times_s)) for kind, times_s in stage.items() if kind not in DRAWINGS]
        longest_drawings = [max(batch, key=get_seconds) for batch in list_drawings(stage, single_drawer)]
        if longest_drawings:  # after the first slice
            first_slice = ("slice_part", min(stage["slice_part"]))
            drawing_path = max(drawing_path, [*path_before, first_slice, *longest_drawings], key=sum_path)
    return max(path, drawing_path, key=sum_path)


def list_drawings(stage: dict[str, list[float]], single_drawer: bool) -> list[list[tuple[str, float]]]:
    """List the drawings of a stage in batches, which run one after another; a batch is drawn in parallel."""
    pictures = [(kind, seconds) for kind in PICTURES for seconds in stage.get(kind, [])]
    pages = [(PAGE, seconds) for seconds in stage.get(PAGE, [])]
    batches = [batch for batch in (pictures, pages) if batch]
    return [[(PAGE, sum_path([*pictures, *pages]))]] if single_drawer and batches else batches


def sum_path(path: list[tuple[str, float]]) -> float:
    """Return the total seconds of a chain of tasks."""
    return sum(seconds for _, seconds in path)


async def run_job(pool: ClusterPool, number: int, stages: Stages, scale: float, single_drawer: bool) -> None:
    """Run a job's tasks in the order of its plan: stage by stage, drawings in parallel with later stages."""

    def start(seconds: float) -> asyncio.Future[None]:
        return asyncio.ensure_future(pool.run(deferred_sleep, seconds * scale, limit=LIMIT, group=number))

    async def draw(stage: dict[str, list[float]]) -> None:
        for batch in list_drawings(stage, single_drawer):
            await asyncio.gather(*(start(seconds) for _, seconds in batch))

    drawings = []
    for stage in stages:
        times_s = [
            seconds
            for kind, kind_times_s in stage.items()
            if kind not in DRAWINGS
            for seconds in kind_times_s
        ]
        tasks = [start(seconds) for seconds in sorted(times_s, reverse=True)]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        drawings.append(asyncio.ensure_future(draw(stage)))
        await asyncio.gather(*tasks)
    await asyncio.gather(*drawings)


async def replay(workers: int, jobs: list[Stages], scale: float, folder: Path) -> dict[str, Any]:
    """Run the jobs on sleeping workers, then again with one worker drawing each job; return the figures."""
    overhead_s: list[float] = []
    logging.getLogger("distributed").setLevel(logging.WARNING)
    with dask.config.set(DISABLED_MONITORING):
        async with Scheduler(host="127.0.0.1", port=0, dashboard_address="127.0.0.1:0") as scheduler:
            executors: list[Any] = [SleepingExecutor(f"w{n}") for n in range(workers)]
            worker_tasks = [
                FarmWorker(scheduler.address, executor, 1, folder / executor.host) for executor in executors
            ]
            await asyncio.gather(*worker_tasks)
            make_connection = partial(TimedConnection, overhead_s, scheduler.address, None, INSTALLATION)
            pool = ClusterPool(RecordingPool(), scheduler.address, INSTALLATION, make_connection)
            pool.start()
            while len(pool.state.workers) < workers:
                await asyncio.sleep(0.1)
            duration_s, cpu_s = await _run_jobs(pool, jobs, scale, single_drawer=False)
            overhead_ms = 1000.0 * statistics.median(overhead_s)
            single_drawer_s, _ = await _run_jobs(pool, jobs, scale, single_drawer=True)
            pool.close()
            await pool.wait_closed()
            await asyncio.gather(*(worker.close() for worker in worker_tasks))
    return {
        "workers": workers,
        "duration_s": duration_s,
        "single_drawer_s": single_drawer_s,
        "ratio": duration_s / single_drawer_s,
        "overhead_ms": overhead_ms,
        **summarise(workers, jobs, duration_s, cpu_s),
    }


async def _run_jobs(
    pool: ClusterPool, jobs: list[Stages], scale: float, single_drawer: bool
) -> tuple[float, float]:
    """Run jobs at the same time; return their unscaled duration and CPU time in seconds."""
    begin_s, begin_cpu_s = time.monotonic(), time.process_time()
    await asyncio.gather(
        *(run_job(pool, number, job, scale, single_drawer) for number, job in enumerate(jobs))
    )
    return (time.monotonic() - begin_s) / scale, time.process_time() - begin_cpu_s


def summarise(workers: int, jobs: list[Stages], duration_s: float, cpu_s: float) -> dict[str, Any]:
    """Return the times of the jobs, and their lower bounds.

    Parameters
    ----------
    duration_s, cpu_s
        Unscaled duration and CPU time of the run in seconds.
    """
    times_s = [
        seconds
        for job in jobs
        for stage in job
        for kind_times_s in stage.values()
        for seconds in kind_times_s
    ]
    longest_path = max((find_critical_path(job) for job in jobs), key=sum_path)
    critical_s = sum_path(longest_path)
    return {
        "jobs": len(jobs),
        "tasks": len(times_s),
        "critical_s": critical_s,
        "bound_s": max(critical_s, sum(times_s) / workers),
        "efficiency": sum(times_s) / (workers * duration_s),
        "cpu_ms_per_task": 1000.0 * cpu_s / len(times_s),
        "critical_path": ", ".join(f"{kind} {seconds:.1f} s" for kind, seconds in longest_path),
        "single_drawer_critical_s": max(
            sum_path(find_critical_path(job, single_drawer=True)) for job in jobs
        ),
    }
