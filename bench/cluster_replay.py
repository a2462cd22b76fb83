"""Recorded jobs run again on simulated workers, through Dask's real scheduler: their tasks only sleep.

Scheduler, workers and farm share one process and one core, so what a task costs is an upper bound. What Dask
does for each worker apart from its tasks (a thread that samples its stack, the ticks of its event loop,
readings of the computer's load) is turned off, as real workers do that on computers of their own.
"""

from __future__ import annotations

import asyncio
import logging
import statistics
import time
from functools import partial
from pathlib import Path
from typing import Any

import dask
from distributed import Scheduler

from dask_cluster import HERE, Recorder
from farm.compute import Deferred, Limit, TaskFiles
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.connection import Connection
from farm.compute.cluster.dask_worker import FarmWorker
from farm.compute.cluster.relocation import dump, load
from farm.compute.cluster.remote_task import RemoteAnswer, RemoteTask

OWN_WORK_OFF = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "10s",
    "distributed.admin.system-monitor.interval": "60s",
}
LIMIT = Limit("sleeping", 600.0)


class SleepingExecutor:
    """Executor whose tasks sleep; see `TaskExecutor`."""

    installation = HERE

    def __init__(self, host: str) -> None:
        self.host = host

    async def execute(self, task: RemoteTask, *_: object) -> RemoteAnswer:
        """Sleep for the seconds that the task names."""
        _, (seconds,) = load(task.call)
        await asyncio.sleep(seconds)
        return RemoteAnswer(self.host, result=dump(None))


class TimedConnection(Connection):
    """Connection that notes how much longer each task takes than its sleep, in s."""

    def __init__(self, late_s: list[float], *args: Any) -> None:
        super().__init__(*args)
        self._late_s = late_s

    async def submit(self, task: RemoteTask, sent: dict[str, bytes]) -> RemoteAnswer:
        """Run a task; see `Connection.submit`."""
        begin_s = time.monotonic()
        answer = await super().submit(task, sent)
        _, (seconds,) = load(task.call)
        self._late_s.append(time.monotonic() - begin_s - seconds)
        return answer


def _list_no_files(_: float) -> TaskFiles:
    return TaskFiles()


sleep = Deferred("time:sleep", _list_no_files)


Stages = list[dict[str, list[float]]]


def find_critical_path(stages: Stages, drawn_first: bool = False) -> list[tuple[str, float]]:
    """Find the longest chain of a job's tasks on workers without number, with the seconds of each.

    Parameters
    ----------
    stages
        See `bench.cluster_jobs.list_stages`.
    drawn_first
        If parts were drawn before they are sliced, in the task that cuts them.
    """
    path: list[tuple[str, float]] = []
    drawn: list[tuple[str, float]] = []
    for stage in stages:
        begin = list(path)
        if drawn_first:
            path += [("draw_job", seconds) for seconds in stage.get("draw_job", [])]
        path += [(what, max(times)) for what, times in stage.items() if what != "draw_job"]
        for seconds in [] if drawn_first else stage.get("draw_job", []):  # behind the first slice
            first = ("slice_part", min(stage["slice_part"]))
            drawn = max(drawn, [*begin, first, ("draw_job", seconds)], key=sum_path)
    return max(path, drawn, key=sum_path)


def sum_path(path: list[tuple[str, float]]) -> float:
    """Return the seconds of a chain."""
    return sum(seconds for _, seconds in path)


async def run_job(pool: ClusterPool, number: int, stages: Stages, scale: float) -> None:
    """Run a job's tasks as a plan does: stage by stage, drawings beside what follows."""

    def start(seconds: float) -> asyncio.Future[None]:
        return asyncio.ensure_future(pool.run(sleep, seconds * scale, limit=LIMIT, group=number))

    drawings = []
    for stage in stages:
        times = [seconds for what, each in stage.items() if what != "draw_job" for seconds in each]
        running = [start(seconds) for seconds in sorted(times, reverse=True)]
        await asyncio.wait(running, return_when=asyncio.FIRST_COMPLETED)
        drawings += [start(seconds) for seconds in stage.get("draw_job", [])]
        await asyncio.gather(*running)
    await asyncio.gather(*drawings)


async def replay(workers: int, jobs: list[Stages], scale: float, folder: Path) -> dict[str, Any]:
    """Run the jobs on sleeping workers. Returns the figures of the run."""
    late_s: list[float] = []
    logging.getLogger("distributed").setLevel(logging.WARNING)
    with dask.config.set(OWN_WORK_OFF):
        async with Scheduler(host="127.0.0.1", port=0, dashboard_address="127.0.0.1:0") as scheduler:
            executors: list[Any] = [SleepingExecutor(f"w{n}") for n in range(workers)]
            serving = [
                FarmWorker(scheduler.address, executor, 1, folder / executor.host) for executor in executors
            ]
            await asyncio.gather(*serving)
            link = partial(TimedConnection, late_s, scheduler.address, None, HERE)
            pool = ClusterPool(Recorder(), scheduler.address, HERE, link)
            pool.start()
            while len(pool.state.workers) < workers:
                await asyncio.sleep(0.1)
            begin_s, begin_cpu_s = time.monotonic(), time.process_time()
            await asyncio.gather(*(run_job(pool, number, job, scale) for number, job in enumerate(jobs)))
            duration_s, cpu_s = time.monotonic() - begin_s, time.process_time() - begin_cpu_s
            pool.close()
            await pool.wait_closed()
            await asyncio.gather(*(worker.close() for worker in serving))
    return {
        "workers": workers,
        "duration_s": duration_s / scale,
        "late_ms": 1000.0 * statistics.median(late_s),
        **sum_up(workers, jobs, duration_s / scale, cpu_s),
    }


def sum_up(workers: int, jobs: list[Stages], duration_s: float, cpu_s: float) -> dict[str, Any]:
    """Return what the jobs needed, and what at least.

    Parameters
    ----------
    duration_s, cpu_s
        Unscaled seconds of the run, and the processor's.
    """
    times = [seconds for job in jobs for stage in job for each in stage.values() for seconds in each]
    longest = max((find_critical_path(job) for job in jobs), key=sum_path)
    critical_s = sum_path(longest)
    return {
        "jobs": len(jobs),
        "tasks": len(times),
        "critical_s": critical_s,
        "bound_s": max(critical_s, sum(times) / workers),
        "efficiency": sum(times) / (workers * duration_s),
        "cpu_ms_per_task": 1000.0 * cpu_s / len(times),
        "critical_path": ", ".join(f"{what} {seconds:.1f} s" for what, seconds in longest),
        "drawn_first_s": max(sum_path(find_critical_path(job, drawn_first=True)) for job in jobs),
    }
