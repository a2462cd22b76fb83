"""A Dask cluster: faults of real processes, and the cost of its scheduler for many workers.

``PYTHONPATH=tests/support python -m bench.cluster faults [--rounds N] [--seed N] [--json]`` runs a scheduler
and four workers with TLS. In each round a dozen tasks run, and in the middle a process is killed or stopped
at random; what was killed is started again. Checked: each task has one result, with the right bytes, and no
process is left.

``... replay [--workers 4,16,64,256] [--jobs N] [--parts N] [--scale F] [--json]`` runs tasks that only sleep
through the real scheduler: each job is cut (`CUT_S`), then all its parts are sliced (lognormal times with the
median `SLICE_S`, the same in each run). Scheduler, workers and farm share one process and one core, so the
overhead is an upper bound. `efficiency` is the work over workers times duration; `critical_s` the longest job
on workers without number; both in unscaled seconds.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
import random
import signal
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

from distributed import Scheduler

from cluster_processes import Processes
from dask_cluster import HERE, Recorder
from farm.compute import Deferred, Limit, TaskFiles, Workers
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.connection import Connection
from farm.compute.cluster.dask_worker import FarmWorker
from farm.compute.cluster.relocation import dump, load
from farm.compute.cluster.remote_task import RemoteAnswer, RemoteTask

WORKERS = ("w1", "w2", "w3", "w4")
TASKS, TASK_S = 12, 1.0
FAULTS = ("kill worker", "stop worker", "kill scheduler", "stop scheduler")
ENDING_S = 10.0  # until the last process is gone
STOPPED_S = 45.0  # until a stopped process goes on
CUT_S, SLICE_S, SPREAD = 20.0, 12.0, 0.6
LIMIT = Limit("sleeping", 600.0)


def _list_files(source: Path, folder: Path, *_: object) -> TaskFiles:
    return TaskFiles(reads=(source,), folders=(folder,))


def work_for(source: Path, folder: Path, seconds: float, note: Path) -> int:
    """Copy a file after some seconds; the process is noted. Returns the file's size."""
    with note.open("a") as file:
        file.write(f"{os.getpid()}\n")
    folder.mkdir(parents=True, exist_ok=True)
    time.sleep(seconds)
    (folder / "copy").write_bytes(source.read_bytes())
    return source.stat().st_size


slow = Deferred("bench.cluster:work_for", _list_files)


# -- faults ---------------------------------------------------------------------------------------------


async def run_faults(rounds: int, seed: int, folder: Path) -> dict[str, Any]:
    """Run rounds with a fault each. Returns their figures."""
    rng, processes = random.Random(seed), Processes(folder)
    source, note = folder / "model.stl", folder / "pids"
    source.write_bytes(rng.randbytes(200_000))
    note.touch()
    figures: list[dict[str, Any]] = []
    own = Workers(folder / "own", 1)
    try:
        address = await processes.start_scheduler()
        for name in WORKERS:
            processes.start_worker(name)
        link = partial(Connection, address, processes.certificates, HERE)
        pool = ClusterPool(own, address, HERE, link)
        pool.start()
        for number in range(rounds):
            while len(pool.state.workers) < len(WORKERS):
                await asyncio.sleep(0.1)
            fault = rng.choice(FAULTS)
            figures.append(await _run_round(pool, processes, fault, rng, (source, note, folder, number)))
        pool.close()
        await pool.wait_closed()
    finally:
        own.close()
        processes.close()
    pids, end_s = set(note.read_text().split()), time.monotonic() + ENDING_S
    while (left := [pid for pid in pids if Path(f"/proc/{pid}").exists()]) and time.monotonic() < end_s:
        await asyncio.sleep(0.1)
    return {"rounds": figures, "wrong": sum(f["wrong"] for f in figures), "left_running": len(left)}


_Files = tuple[Path, Path, Path, int]


async def _run_round(
    pool: ClusterPool,
    processes: Processes,
    fault: str,
    rng: random.Random,
    files: _Files,
) -> dict[str, Any]:
    source, note, folder, number = files
    outs = [folder / "out" / f"{number}-{task}" for task in range(TASKS)]
    before, begin_s = note.read_text().count("\n"), time.monotonic()
    running = [
        asyncio.ensure_future(pool.run(slow, source, out, TASK_S, note, limit=LIMIT, group=number))
        for out in outs
    ]
    await asyncio.sleep(rng.uniform(0.2, 2.0) * TASK_S)
    victim = "scheduler" if fault.endswith("scheduler") else rng.choice(WORKERS)
    processes.send(victim, signal.SIGKILL if fault.startswith("kill") else signal.SIGSTOP)
    healing = asyncio.ensure_future(_heal(processes, fault, victim, rng.uniform(0.0, 5.0)))
    sizes = await asyncio.gather(*running)
    duration_s = time.monotonic() - begin_s
    await healing
    content = source.read_bytes()
    right = [
        size == len(content) and (out / "copy").read_bytes() == content
        for size, out in zip(sizes, outs, strict=True)
    ]
    return {
        "fault": fault,
        "duration_s": duration_s,
        "starts": note.read_text().count("\n") - before,
        "wrong": TASKS - sum(right),
    }


async def _heal(processes: Processes, fault: str, victim: str, after_s: float) -> None:
    """Start what was killed, let go on what was stopped."""
    if fault.startswith("stop"):
        await asyncio.sleep(STOPPED_S)
        processes.send(victim, signal.SIGCONT)
        return
    await asyncio.sleep(after_s)
    if victim == "scheduler":
        await processes.start_scheduler()
    else:
        processes.start_worker(victim)


# -- replay ---------------------------------------------------------------------------------------------


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


def _list_no_files(_: float) -> TaskFiles:
    return TaskFiles()


sleep = Deferred("time:sleep", _list_no_files)


def draw_jobs(jobs: int, parts: int) -> list[list[float]]:
    """Draw the seconds of each part's slice, for each job."""
    rng = random.Random(1)
    return [[rng.lognormvariate(math.log(SLICE_S), SPREAD) for _ in range(parts)] for _ in range(jobs)]


async def replay(workers: int, jobs: list[list[float]], scale: float, folder: Path) -> dict[str, Any]:
    """Run the jobs on sleeping workers. Returns the figures of the run."""

    async def run_job(pool: ClusterPool, number: int, slices_s: list[float]) -> None:
        await pool.run(sleep, CUT_S * scale, limit=LIMIT, group=number)
        longest_first = sorted(slices_s, reverse=True)
        await asyncio.gather(*(pool.run(sleep, s * scale, limit=LIMIT, group=number) for s in longest_first))

    async with Scheduler(host="127.0.0.1", port=0, dashboard_address="127.0.0.1:0") as scheduler:
        serving = [
            FarmWorker(scheduler.address, SleepingExecutor(f"w{n}"), 1, folder / f"w{n}")  # type: ignore[arg-type]
            for n in range(workers)
        ]
        await asyncio.gather(*serving)
        link = partial(Connection, scheduler.address, None, HERE)
        pool = ClusterPool(Recorder(), scheduler.address, HERE, link)
        pool.start()
        while len(pool.state.workers) < workers:
            await asyncio.sleep(0.1)
        begin_s, begin_cpu_s = time.monotonic(), time.process_time()
        await asyncio.gather(*(run_job(pool, number, slices) for number, slices in enumerate(jobs)))
        duration_s, cpu_s = time.monotonic() - begin_s, time.process_time() - begin_cpu_s
        pool.close()
        await pool.wait_closed()
        await asyncio.gather(*(worker.close() for worker in serving))
    tasks = sum(len(slices) + 1 for slices in jobs)
    work_s = sum(CUT_S + sum(slices) for slices in jobs)
    critical_s = max(CUT_S + max(slices) for slices in jobs)
    return {
        "workers": workers,
        "tasks": tasks,
        "duration_s": duration_s / scale,
        "critical_s": critical_s,
        "bound_s": max(critical_s, work_s / workers),
        "efficiency": work_s * scale / (workers * duration_s),
        "cpu_ms_per_task": 1000.0 * cpu_s / tasks,
    }


def main() -> None:
    """Parse the command line, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("what", choices=["faults", "replay"])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", default="4,16,64,256")
    parser.add_argument("--jobs", type=int, default=8)
    parser.add_argument("--parts", type=int, default=100)
    parser.add_argument("--scale", type=float, default=0.1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="farm-cluster-") as name:
        folder = Path(name)
        if args.what == "faults":
            figures = asyncio.run(run_faults(args.rounds, args.seed, folder))
            rows = figures["rounds"]
        else:
            jobs = draw_jobs(args.jobs, args.parts)
            rows = [
                asyncio.run(replay(int(count), jobs, args.scale, folder / count))
                for count in args.workers.split(",")
            ]
            figures = {"runs": rows}
    if args.json:
        print(json.dumps(figures))
        return
    for row in rows:
        print("  ".join(f"{key} {value:.4g}" if key != "fault" else str(value) for key, value in row.items()))
    if args.what == "faults":
        print(f"wrong results {figures['wrong']}, processes left {figures['left_running']}")


if __name__ == "__main__":
    main()
