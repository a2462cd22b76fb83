"""A cluster on separate hosts, whose processes and network fail while a small job is planned.

The scheduler (`dask scheduler`) and four workers (`farm worker`) run with TLS in network namespaces. In each
round a job is planned while other tasks run, and at a random moment a fault is caused, then repaired.
"""

from __future__ import annotations

import asyncio
import os
import random
import shutil
import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import trimesh

from bench.clusters.hosts import END_TIMEOUT_S, FARM, NICE, SAMPLE_S, SCHEDULER, WORKERS, Hosts, list_children
from farm.compute import DeferredFunction, Limit, Pool, TaskFiles, WorkerPool
from farm.compute.cluster import ClusterPool, Place, cluster_pool, connect_cluster
from farm.compute.cluster.remote_task import RemoteTask
from farm.config import Fleet
from farm.http.routes.status import describe_cluster
from farm.model import Job, JobOptions
from farm.paths import StateFolder
from farm.planning.inspection.inspect_submission import inspect_model
from farm.planning.job_planner import JobPlanner
from farm.planning.plan import Plan, PlanRequest

KILLS = ("kill worker", "kill scheduler")
STOPS = ("stop worker", "stop scheduler")
NETWORK_FAULTS = (
    "disconnect worker",
    "disconnect scheduler",
    "disconnect farm",
    "delay packets",
    "drop packets",
)
FAULTS = (*KILLS, *STOPS, *NETWORK_FAULTS)
FAULT_DURATION_S = 40.0  # time for which a process is stopped, or the network disturbed
DELAY_S, LOSS_SHARE = 0.3, 0.05  # delay and share of lost packets at each host, in both directions
TASK_COUNT, TASK_S = 8, 4.0
START_RANGE_S = (0.3, 7.0)  # a fault starts in this range of a round; tasks run for 8 s on four workers
PRINTER_MODEL, MODEL_COUNT, PRINTER_COUNT, BUDGET_S = "ultimaker2_plus", 3, 3, 1.0
LIMIT = Limit("sleeping", 600.0)
UNCOMPARED_FIELDS = ("decomposition", "cached")  # duration of planning, cached slices
FLEET = Fleet.model_validate(
    {
        "printers": [
            {"name": f"p{n}", "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"}
            for n in range(PRINTER_COUNT)
        ]
    }
)


def _list_files(source: Path, folder: Path, *_: object) -> TaskFiles:
    return TaskFiles(input_files=(source,), output_folders=(folder,))


def copy_after_delay(source: Path, folder: Path, seconds: float) -> int:
    """Copy a file after a delay, and return its size."""
    folder.mkdir(parents=True, exist_ok=True)
    time.sleep(seconds)
    (folder / "copy").write_bytes(source.read_bytes())
    return source.stat().st_size


deferred_copy = DeferredFunction("bench.clusters.faults:copy_after_delay", _list_files)


@dataclass
class StatusSampler:
    """Samples of the sentence about the cluster in `farm status`, taken while tasks were open.

    Attributes
    ----------
    samples, place_samples, wait_samples
        Number of all samples, of those that say where tasks run, and of those that say what they wait for.
    longest_silence_s
        Longest time in which the sentence said neither where the tasks run nor what they wait for.
    used_local_pool
        True if it said that this computer runs the tasks.
    """

    samples: int = 0
    place_samples: int = 0
    wait_samples: int = 0
    longest_silence_s: float = 0.0
    used_local_pool: bool = False
    texts: list[str] = field(default_factory=list)

    async def follow(self, pool: ClusterPool) -> None:
        """Poll the sentence of `farm status` until cancelled."""
        last_named_s = time.monotonic()
        while True:
            state = pool.state
            view = describe_cluster(state)
            names_place = any(phrase in view.text for phrase in ("running: ", "this computer"))
            names_wait = "wait" in view.text or "not started" in view.text
            now_s = time.monotonic()
            if names_place or names_wait or not (state.tasks or state.waiting_count or state.local_count):
                last_named_s = now_s
            self.samples += 1
            self.place_samples, self.wait_samples = (
                self.place_samples + names_place,
                self.wait_samples + names_wait,
            )
            self.longest_silence_s = max(self.longest_silence_s, now_s - last_named_s)
            self.used_local_pool = self.used_local_pool or state.place is Place.THIS_COMPUTER
            if not self.texts or self.texts[-1].split(",")[0] != view.text.split(",")[0]:
                self.texts.append(view.text)
            await asyncio.sleep(SAMPLE_S)


class UsedResults:
    """Counts of the results whose files were written, by task."""

    def __init__(self) -> None:
        self.counts_by_task: Counter[tuple[str, ...]] = Counter()
        self._write = cluster_pool.write_files

    def write(self, task: RemoteTask, files: dict[str, bytes]) -> None:
        """Write files as `remote_task.write_files` does, and count those that are results."""
        if not set(files) <= set(task.live_files):
            self.counts_by_task[(task.limit.work_name, *task.output_folders, *task.output_files)] += 1
        self._write(task, files)

    def count_repeated(self) -> int:
        """Return the number of results that were used more than once."""
        return sum(count > 1 for count in self.counts_by_task.values())


class FaultRounds:
    """Rounds on one cluster, each with one fault.

    Parameters
    ----------
    pool
        Pool on the cluster.
    local_pool
        Pool of this computer, on which the same job is planned for comparison.
    """

    def __init__(self, hosts: Hosts, pool: ClusterPool, local_pool: WorkerPool, rng: random.Random) -> None:
        self._hosts, self._pool, self._local_pool, self._rng = hosts, pool, local_pool, rng
        self._initial_processes: Counter[str] = Counter()  # processes of each host before the first fault
        self._folder, self._local_plans = hosts.folder, dict[int, Any]()
        self._source = hosts.folder / "model.bin"
        self._source.write_bytes(rng.randbytes(200_000))

    async def run(self, number: int, fault: str) -> dict[str, Any]:
        """Run a round, and return its figures."""
        pool, rng = self._pool, self._rng
        while not (pool.state.place is Place.CLUSTER and len(pool.state.workers) == len(WORKERS)):
            await asyncio.sleep(SAMPLE_S)
        self._initial_processes = self._initial_processes or self._count_processes()
        output_folders = [self._folder / f"round-{number}" / f"out-{task}" for task in range(TASK_COUNT)]
        state = StateFolder(self._folder / f"round-{number}" / "cluster")
        job = self._make_job(number, state)
        used_results, sampler = UsedResults(), StatusSampler()
        cluster_pool.write_files = used_results.write
        sampling_task = asyncio.ensure_future(sampler.follow(pool))
        fault_start_s = rng.uniform(*START_RANGE_S)
        start_s = time.monotonic()
        plan_task = asyncio.ensure_future(_plan(state, job, pool))
        tasks = [asyncio.ensure_future(self._run_task(path)) for path in output_folders]
        fault_task = asyncio.ensure_future(self._cause_fault(fault, fault_start_s, rng.uniform(0.0, 5.0)))
        try:
            task_results = await asyncio.gather(*tasks)
            plan = await plan_task
            duration_s = time.monotonic() - start_s
            sampling_task.cancel()
            victim = await fault_task
            task_count, processes = await self._wait_for_end_of_tasks()
        finally:
            sampling_task.cancel()
            cluster_pool.write_files = used_results._write
        local_plan = await self._plan_locally(number)
        shutil.rmtree(self._folder / f"round-{number}")
        status_figures = asdict(sampler)
        return {
            "fault": fault,
            "victim": victim,
            "after_s": fault_start_s,
            "duration_s": duration_s,
            "during_job": fault_start_s < duration_s,
            "job_ended": isinstance(plan, Plan),
            "differences": list_differences(plan, local_plan),
            "correct_tasks": sum(task_results),
            "results_taken_twice": used_results.count_repeated(),
            "remaining_tasks": task_count,
            "processes": processes,
            "extra_processes": (processes - self._initial_processes).total(),
            **status_figures,
        }

    async def _plan_locally(self, number: int) -> Any:
        """Plan the job of a round on this computer, or return its plan from an earlier round."""
        model_index = number % MODEL_COUNT
        if model_index not in self._local_plans:
            state = StateFolder(self._folder / f"round-{number}" / "local")
            for pid in self._local_pool.pids:
                os.setpriority(os.PRIO_PROCESS, pid, NICE + 19)
            self._local_plans[model_index] = await _plan(
                state, self._make_job(number, state), self._local_pool
            )
        return self._local_plans[model_index]

    def _make_job(self, number: int, state: StateFolder) -> Job:
        """Make the job of a round, with one of a few models."""
        state.make()
        path = state.root / "bar.stl"
        trimesh.creation.box((250.0 + 5.0 * (number % MODEL_COUNT), 16.0, 12.0)).export(path)
        options = JobOptions(printers=PRINTER_COUNT)
        model = inspect_model(path, "bar.stl", options, state.files)
        return Job(
            id=1, request_id="r" * 8, name="bar", model_file=model.file, options=options, submitted_s=0.0
        )

    async def _run_task(self, path: Path) -> bool:
        """Run a task in parallel with the job; return True if its result is correct."""
        size = await self._pool.run(deferred_copy, self._source, path, TASK_S, limit=LIMIT, group="tasks")
        content = self._source.read_bytes()
        return size == len(content) and (path / "copy").read_bytes() == content

    async def _cause_fault(self, fault: str, delay_s: float, restart_s: float) -> str:
        """Cause a fault after some seconds, and repair it; return the names of its hosts."""
        await asyncio.sleep(delay_s)
        kind, _, target = fault.partition(" ")
        victims = {"worker": [self._rng.choice(WORKERS)], "scheduler": [SCHEDULER], "farm": [FARM]}
        names = victims.get(target, [FARM, SCHEDULER, *WORKERS])
        if fault in KILLS:
            self._hosts.send_signal(names[0], signal.SIGKILL)
            await asyncio.sleep(restart_s)
            self._hosts.start(names[0])
        elif fault in STOPS:
            self._hosts.send_signal(names[0], signal.SIGSTOP)
            await asyncio.sleep(FAULT_DURATION_S)
            self._hosts.send_signal(names[0], signal.SIGCONT)
        else:
            self._hosts.network.set_faults(
                *names,
                cut=kind == "disconnect",
                delay_s=DELAY_S if kind == "delay" else 0.0,
                loss=LOSS_SHARE if kind == "drop" else 0.0,
            )
            await asyncio.sleep(FAULT_DURATION_S)
            self._hosts.network.set_faults(*names)
        return ", ".join(names)

    async def _wait_for_end_of_tasks(self) -> tuple[int, Counter[str]]:
        """Wait until no host has a task, or a process of a task.

        Returns
        -------
        tuple[int, Counter[str]]
            Number of remaining tasks, and number of processes on each host.
        """
        deadline_s = time.monotonic() + END_TIMEOUT_S
        while True:
            task_count = await asyncio.to_thread(self._hosts.count_tasks)
            processes = await asyncio.to_thread(self._count_processes)
            if not (task_count or processes - self._initial_processes) or time.monotonic() >= deadline_s:
                return task_count, processes
            await asyncio.sleep(SAMPLE_S)

    def _count_processes(self) -> Counter[str]:
        """Count the processes of each host; on the farm's host, those of the local pool and its engines."""
        engines = sum(len(list_children(pid)) for pid in self._local_pool.pids)
        return Counter({FARM: len(self._local_pool.pids) + engines, **self._hosts.count_processes()})


async def _plan(state: StateFolder, job: Job, pool: Pool) -> Any:
    """Plan a job; return the plan, or the error."""
    future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
    planner = JobPlanner(state, pool, BUDGET_S, lambda _, result: future.set_result(result), lambda *_: None)
    planner.start(PlanRequest(job, FLEET.printers))
    return await future


def list_differences(plan: Any, local_plan: Any) -> list[str]:
    """List the fields in which two plans differ; files of parts and plates are named by their content."""
    if not isinstance(plan, Plan) or not isinstance(local_plan, Plan):
        return [f"{plan} and {local_plan}"]
    pairs: list[tuple[str, Any, Any]] = []
    for item in fields(Plan):
        values, local_values = getattr(plan, item.name), getattr(local_plan, item.name)
        if item.name not in ("parts", "plates"):
            pairs.append((item.name, values, local_values))
        elif len(values) != len(local_values):
            pairs.append((item.name, len(values), len(local_values)))
        else:
            pairs += [
                (f"{record.id} {name}", value, dict(local_record)[name])
                for record, local_record in zip(values, local_values, strict=True)
                for name, value in record
            ]
    return [
        f"{name}: {value!r:.200} and {local_value!r:.200}"
        for name, value, local_value in pairs
        if value != local_value and name.rpartition(" ")[2] not in UNCOMPARED_FIELDS
    ]


async def run_faults(
    rounds: int, seed: int, folder: Path, report: Callable[[dict[str, Any]], None]
) -> dict[str, Any]:
    """Run rounds with one fault each: every kind once in random order, then every kind again.

    Parameters
    ----------
    report
        Function that is called with the figures of each round.
    """
    rng = random.Random(seed)
    kinds = [fault for _ in range(0, rounds, len(FAULTS)) for fault in rng.sample(FAULTS, len(FAULTS))]
    hosts = Hosts(folder, seed)
    figures: list[dict[str, Any]] = []
    local_pool = WorkerPool(folder / "own", 1)
    task_count = -1
    try:
        hosts.start(SCHEDULER)
        for name in WORKERS:
            hosts.start(name)
        pool = connect_cluster(local_pool, hosts.address, hosts.certificates)
        pool.start()
        fault_rounds = FaultRounds(hosts, pool, local_pool, rng)
        for number, fault in enumerate(kinds[:rounds]):
            figures.append(await fault_rounds.run(number + 1, fault))
            report(figures[-1])
        pool.close()
        await pool.wait_closed()
        task_count = await asyncio.to_thread(hosts.end)
    finally:
        local_pool.close()
        await asyncio.to_thread(hosts.close)
    return {"rounds": figures, **_summarise(figures), "processes_left": task_count}


def _summarise(figures: list[dict[str, Any]]) -> dict[str, Any]:
    durations_s = sorted(row["duration_s"] for row in figures)
    return {
        "during_job": sum(row["during_job"] for row in figures),
        "jobs_ended": sum(row["job_ended"] for row in figures),
        "same_plans": sum(not row["differences"] for row in figures),
        "correct_tasks": sum(row["correct_tasks"] for row in figures),
        "tasks": TASK_COUNT * len(figures),
        "results_taken_twice": sum(row["results_taken_twice"] for row in figures),
        "remaining_tasks": sum(row["remaining_tasks"] for row in figures),
        "extra_processes": sum(row["extra_processes"] for row in figures),
        "used_local_pool": sum(row["used_local_pool"] for row in figures),
        "longest_silence_s": max(row["longest_silence_s"] for row in figures),
        "duration_s": [durations_s[0], durations_s[len(durations_s) // 2], durations_s[-1]],
    }
