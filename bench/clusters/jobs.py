"""Real jobs planned on one and on two workers of this computer, and the times of their tasks.

Parts are cut from a random model (`bench.unseen`) and sliced by CuraEngine. The CPU time of each task
does not depend on other load, and the ratio of the durations hardly depends on it.
"""

from __future__ import annotations

import asyncio
import json
import resource
import shutil
import time
from collections.abc import Callable, Hashable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.unseen import draw_model
from decompose.files.names import REPORT
from decompose.geometry import round_triangles, write_stl
from farm.compute import CHECKING_LIMIT, DeferredFunction, Limit, Pool, PoolShare, WorkerPool
from farm.config import Fleet
from farm.model import Job, JobOptions
from farm.paths import StateFolder
from farm.planning.inspection.inspect_submission import inspect_model
from farm.planning.job_planner import JobPlanner
from farm.planning.parts.drawings import split_steps
from farm.planning.parts.search_rounds import SearchRounds
from farm.planning.plan import DecomposedJob, DecomposeTask, Plan, PlanRequest
from farm.planning.tasks import (
    decompose_job,
    draw_job_parts,
    draw_overview,
    draw_step_range,
    warm_up_planning,
)

PRINTER_MODEL = "ultimaker2_plus"
MODEL_KIND, MODEL_SEED = "organic", 1
SIDE_MM = 200.0  # longest side of the model for 20 printers; parts are small, so slices take only seconds
BUDGET_S = 5.0
PARALLEL_TASKS = {"slice_part", "draw_overview", "draw_step_range", "draw_job_parts", "make_attempt"}
"""Tasks of which several run at the same time."""


@dataclass(frozen=True, slots=True)
class TimedTask:
    """Task of a job: its start and end, from the start of the job, and its CPU time, CuraEngine included."""

    kind: str
    begin_s: float
    end_s: float
    cpu_s: float


def time_call(work: Callable[..., Any], *args: object) -> tuple[Any, float]:
    """Call a function; return its result and its CPU seconds, including those of its child processes."""
    start_cpu_s = _read_cpu_s()
    return work(*args), _read_cpu_s() - start_cpu_s


deferred_time_call = DeferredFunction("bench.clusters.jobs:time_call")


def _read_cpu_s() -> float:
    usages = (resource.getrusage(scope) for scope in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


class TimingPool:
    """Pool that records the times of its tasks; see `farm.compute.pool.Pool`."""

    def __init__(self, pool: Pool) -> None:
        self._pool, self._begin_s = pool, time.monotonic()
        self.tasks: list[TimedTask] = []

    @property
    def memory_bytes(self) -> int:
        """Memory of each worker."""
        return self._pool.memory_bytes

    @property
    def start_step(self) -> str | None:
        """Current step of the workers' start; None once they have started."""
        return self._pool.start_step

    @property
    def has_idle_worker(self) -> bool:
        """True if a task would start at once."""
        return self._pool.has_idle_worker

    async def run(
        self, work: Callable[..., Any], *args: object, limit: Limit = CHECKING_LIMIT, group: Hashable = None
    ) -> Any:
        """Run a function, and record its times."""
        begin_s = time.monotonic()
        result, cpu_s = await self._pool.run(deferred_time_call, work, *args, limit=limit, group=group)
        end_s = time.monotonic()
        name = getattr(work, "target", "").rpartition(":")[2]
        self.tasks.append(TimedTask(name, begin_s - self._begin_s, end_s - self._begin_s, cpu_s))
        return result

    def close(self) -> None:
        """Close the pool."""
        self._pool.close()


def measure_job(part_count: int, worker_count: int, folder: Path) -> dict[str, Any]:
    """Plan a job with a number of parts on a number of workers; return its figures and its tasks."""
    return asyncio.run(_measure_job(part_count, worker_count, folder))


async def _measure_job(part_count: int, worker_count: int, folder: Path) -> dict[str, Any]:
    state = StateFolder(folder / f"{part_count}-{worker_count}")
    local_pool = WorkerPool(folder / "workers", worker_count, warm_up=warm_up_planning)
    while local_pool.start_step is not None:
        await asyncio.sleep(0.1)
    try:
        job, fleet = _make_job(part_count, state)
        pool = TimingPool(local_pool)
        future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        planner = JobPlanner(state, pool, BUDGET_S, lambda _, plan: future.set_result(plan), lambda *_: None)
        start_s = time.monotonic()
        planner.start(PlanRequest(job, fleet.printers))
        plan = await future
        duration_s = time.monotonic() - start_s
    finally:
        local_pool.close()
    shutil.rmtree(state.root)
    if not isinstance(plan, Plan):
        raise SystemExit(f"{part_count} parts: {plan}")
    return {
        "parts": len(plan.plates),
        "workers": worker_count,
        "duration_s": duration_s,
        "cpu_s": sum(task.cpu_s for task in pool.tasks),
        "expected_s": plan.expected_s,
        "plates": sorted(plate.sha256 for plate in plan.plates),
        "tasks": [asdict(task) for task in pool.tasks],
    }


def measure_search(part_count: int, worker_count: int, budget_s: float, folder: Path) -> dict[str, Any]:
    """Search for the parts of a job on a number of workers, without slicing them.

    Returns
    -------
    dict
        `duration_s`; `cpu_s` of all tasks; `critical_s`, the sum of the longest task of each stage; `ratio`,
        `critical_s` as a share of `cpu_s`; `attempts`, the number of tasks of each stage; `makespan_s`;
        `effort_s`; `tasks`.
    """
    return asyncio.run(_measure_search(part_count, worker_count, budget_s, folder))


async def _measure_search(
    part_count: int, worker_count: int, budget_s: float, folder: Path
) -> dict[str, Any]:
    state = StateFolder(folder / f"{part_count}-{worker_count}-search")
    local_pool = WorkerPool(folder / "workers", worker_count, warm_up=warm_up_planning)
    while local_pool.start_step is not None:
        await asyncio.sleep(0.1)
    try:
        job, fleet = _make_job(part_count, state)
        work = state.work / "job"
        work.mkdir(parents=True)
        model = state.files / job.model_file
        task = DecomposeTask(
            1, model, job.options, fleet.printers, 1, work, budget_s=budget_s, may_pause=True
        )
        pool = TimingPool(local_pool)
        start_s = time.monotonic()
        decomposed_job = await SearchRounds(PoolShare(pool, 1), task).run()
        duration_s = time.monotonic() - start_s
    finally:
        local_pool.close()
    report = json.loads((work / REPORT).read_text())
    shutil.rmtree(state.root)
    tasks = [asdict(timed_task) for timed_task in pool.tasks]
    stages = list_stages(tasks)
    critical_s = sum(max(times_s) for stage in stages for times_s in stage.values())
    cpu_s = sum(timed_task.cpu_s for timed_task in pool.tasks)
    return {
        "parts": len(decomposed_job.parts),
        "workers": worker_count,
        "duration_s": duration_s,
        "cpu_s": cpu_s,
        "critical_s": critical_s,
        "ratio": critical_s / cpu_s,
        "attempts": [len(times_s) for stage in stages for times_s in stage.values()],
        "makespan_s": report["makespan_s"],
        "effort_s": sum(attempt["effort_s"] for attempt in report["attempts"]),
        "tasks": tasks,
    }


def measure_drawing(part_count: int, folder: Path) -> dict[str, Any]:
    """Decompose a job, and draw its parts on one worker and on several.

    Returns
    -------
    dict
        `single_drawer_s`, the CPU seconds if one worker draws; `tasks`, the CPU seconds of the tasks as in a
        stage of `list_stages`; `critical_s`, the sum of the longest picture and the page; and `ratio`,
        `critical_s` as a share of `single_drawer_s`.
    """
    state = StateFolder(folder / f"{part_count}-drawn")
    job, fleet = _make_job(part_count, state)
    work = state.work / "job"
    work.mkdir(parents=True)
    model = state.files / job.model_file
    task = DecomposeTask(1, model, job.options, fleet.printers, 1, work, budget_s=BUDGET_S)
    decomposition = decompose_job(task)
    assert isinstance(decomposition, DecomposedJob)  # a search pauses only with `may_pause`
    record, overview = decomposition.drawing_record, work / "overview.png"
    ranges = split_steps(decomposition.step_count)
    files = [work / f"steps-{begin}.pickle" for begin, _ in ranges]
    time_call(draw_overview, record, overview)  # the first call loads the modules
    _, single_drawer_s = time_call(draw_job_parts, task, record)
    tasks = {
        "draw_overview": [time_call(draw_overview, record, overview)[1]],
        "draw_step_range": [
            time_call(draw_step_range, record, begin, end, file)[1]
            for (begin, end), file in zip(ranges, files, strict=True)
        ],
        "draw_job_parts": [time_call(draw_job_parts, task, record, overview, tuple(files))[1]],
    }
    shutil.rmtree(state.root)
    critical_s = max(*tasks["draw_overview"], *tasks["draw_step_range"]) + sum(tasks["draw_job_parts"])
    return {
        "parts": len(decomposition.parts),
        "single_drawer_s": single_drawer_s,
        "tasks": tasks,
        "critical_s": critical_s,
        "ratio": critical_s / single_drawer_s,
    }


def list_stages(tasks: list[dict[str, Any]]) -> list[dict[str, list[float]]]:
    """Group the tasks of a job by stage.

    Returns
    -------
    list
        CPU seconds of the tasks of each stage, by their kind, in the order of the stages. Parts are drawn in
        the stage in which they are sliced.
    """
    stages: list[dict[str, list[float]]] = []
    for task in sorted(tasks, key=lambda task: float(task["begin_s"])):
        kind = task["kind"]
        if kind not in PARALLEL_TASKS or not stages or set(stages[-1]) - PARALLEL_TASKS:
            stages.append({})
        stages[-1].setdefault(kind, []).append(task["cpu_s"])
    return stages


def _make_job(printer_count: int, state: StateFolder) -> tuple[Job, Fleet]:
    """Make a fleet of printers, and a job whose model's volume is proportional to their number."""
    state.make()
    model = draw_model(MODEL_KIND, MODEL_SEED, SIDE_MM * (printer_count / 20.0) ** (1.0 / 3.0))
    corners = round_triangles(*model.solid.arrays())
    assert corners is not None
    path = state.root / f"{MODEL_KIND}.stl"
    write_stl(path, corners)
    options = JobOptions(printers=printer_count)
    inspection = inspect_model(path, path.name, options, state.files)
    job = Job(
        id=1,
        request_id="r" * 8,
        name=MODEL_KIND,
        model_file=inspection.file,
        options=options,
        submitted_s=0.0,
    )
    sections = [
        {"name": f"p{n}", "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"}
        for n in range(printer_count)
    ]
    return job, Fleet.model_validate({"printers": sections})
