"""A Dask cluster: faults of real processes, and the cost of its scheduler for many workers.

``PYTHONPATH=tests/support python -m bench.cluster faults [--rounds N] [--seed N] [--json]``, as root, runs
rounds in which a process or the network fails; see `bench.cluster_faults`. The figures of each round are
printed when it ends, with `--json` to standard error. Checked: the job is planned as on one computer, each
result is taken once, no task and in the end no process is left on any host.

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
import random
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

from distributed import Scheduler

from dask_cluster import HERE, Recorder
from farm.compute import Deferred, Limit, TaskFiles
from farm.compute.cluster.cluster_pool import ClusterPool
from farm.compute.cluster.connection import Connection
from farm.compute.cluster.dask_worker import FarmWorker
from farm.compute.cluster.relocation import dump, load
from farm.compute.cluster.remote_task import RemoteAnswer, RemoteTask

CUT_S, SLICE_S, SPREAD = 20.0, 12.0, 0.6
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
            figures = measure_faults(args.rounds, args.seed, folder, args.json)
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
    for row in figures["runs"] if args.what == "replay" else [figures]:
        print("  ".join(f"{key} {value:.4g}" for key, value in row.items() if isinstance(value, int | float)))


def measure_faults(rounds: int, seed: int, folder: Path, as_json: bool) -> dict[str, Any]:
    """Run rounds with faults; see `run_faults`. Prints the figures of each."""
    from bench.cluster_faults import run_faults  # needs the command ip, and root
    from virtual_network import find_obstacle

    obstacle = find_obstacle()
    if obstacle is not None:
        raise SystemExit(f"not run: {obstacle}")

    def report(row: dict[str, Any]) -> None:
        print(json.dumps(row), file=sys.stderr if as_json else sys.stdout, flush=True)

    return asyncio.run(run_faults(rounds, seed, folder, report))


if __name__ == "__main__":
    main()
