"""A job planned by one worker, by two, and on a cluster without a shared disk: same parts, bytes and plan."""

import asyncio
import json
from collections import Counter
from dataclasses import replace
from typing import ClassVar

import pytest
import trimesh

from clusters.dask_cluster import run_cluster
from farm.compute import DECOMPOSING_LIMIT, WorkerPool
from farm.config import Fleet
from farm.model import Job, JobOptions
from farm.paths import StateFolder
from farm.planning.inspection.inspect_submission import inspect_model
from farm.planning.job_planner import JobPlanner
from farm.planning.parts import drawings
from farm.planning.plan import PlanRequest

PRINTER_MODEL = "ultimaker2_plus"
GUILLOTINE_OPTIONS = JobOptions(engine="guillotine")
ROUNDS_BUDGET_S = 20.0
"""Budget of a search that makes a round of several attempts to cut the bar."""
FLEET = Fleet.model_validate(
    {"printers": [{"name": n, "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"} for n in "abc"]}
)


async def plan_job(state, job, pool, budget_s=5.0):
    future = asyncio.get_running_loop().create_future()
    planner = JobPlanner(state, pool, budget_s, lambda _, result: future.set_result(result), lambda *_: None)
    planner.start(PlanRequest(job, FLEET.printers))
    return await future


def make_job(state, path, options=GUILLOTINE_OPTIONS):
    state.make()
    model = inspect_model(path, "bar.stl", options, state.files)
    return Job(id=1, request_id="r" * 8, name="bar", model_file=model.file, options=options, submitted_s=0.0)


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "bar.stl"
    trimesh.creation.box((260.0, 14.0, 12.0)).export(path)
    return path


def plan_locally(folder, bar, count):
    """Plan a job with this number of worker processes."""
    state = StateFolder(folder)

    async def main():
        job = make_job(state, bar)
        workers = WorkerPool(folder / "workers", count)
        try:
            return await plan_job(state, job, workers)
        finally:
            workers.close()

    return state, asyncio.run(main())


def list_stored_files(state):
    return {file.name for file in state.files.iterdir() if file.suffix != ".json"}


@pytest.fixture(scope="module")
def planned_job(bar, tmp_path_factory):
    """Plan with one worker; return state folder and plan."""
    return plan_locally(tmp_path_factory.mktemp("one") / "state", bar, 1)


@pytest.fixture
def parallel_drawings(monkeypatch):
    """Let several workers draw pictures even of a few parts."""
    monkeypatch.setattr(drawings, "MIN_STEPS", 1)


@pytest.mark.usefixtures("parallel_drawings")
def test_one_worker_and_two_workers_make_the_same_plan(planned_job, bar, tmp_path):
    state, plan_by_one_worker = planned_job
    two_workers_state, plan_by_two_workers = plan_locally(tmp_path / "two", bar, 2)
    # The decomposition contains the duration of the planning.
    assert plan_by_two_workers == replace(plan_by_one_worker, decomposition=plan_by_two_workers.decomposition)
    assert len(plan_by_two_workers.plates) == 3
    assert list_stored_files(state) == list_stored_files(two_workers_state)


@pytest.mark.usefixtures("parallel_drawings")
def test_cluster_makes_the_same_plan_as_this_computer(planned_job, bar, tmp_path):
    local_state, local_plan = planned_job
    remote_state = StateFolder(tmp_path / "there")

    async def main():
        job = make_job(remote_state, bar)
        async with run_cluster(tmp_path / "cluster", ["w1", "w2"]) as (pool, _):
            remote_plan = await plan_job(remote_state, job, pool)
            assert pool.recording_pool.calls == []
        return remote_plan

    remote_plan = asyncio.run(main())
    assert remote_plan == replace(local_plan, decomposition=remote_plan.decomposition)
    assert list_stored_files(local_state) == list_stored_files(remote_state)
    assert not list(remote_state.work.iterdir()) and not list(remote_state.slices.iterdir())


class CountingWorkers(WorkerPool):
    """Workers that count the tasks that run at the same time on all of them."""

    running_tasks: ClassVar[Counter[str]] = Counter()
    max_running_tasks: ClassVar[Counter[str]] = Counter()

    async def run(self, work, *args, limit=None, group=None):
        cls = CountingWorkers
        cls.running_tasks[limit.work_name] += 1
        cls.max_running_tasks[limit.work_name] = max(
            cls.max_running_tasks[limit.work_name], cls.running_tasks[limit.work_name]
        )
        try:
            return await super().run(work, *args, limit=limit, group=group)
        finally:
            cls.running_tasks[limit.work_name] -= 1


def read_attempts(state, result):
    attempts = json.loads((state.files / result.decomposition).read_text())["attempts"]
    return [{key: value for key, value in attempt.items() if key != "compute_s"} for attempt in attempts]


def test_parallel_attempts_make_the_same_plan_as_one_worker(bar, tmp_path):
    """Use a budget for a round of three attempts, on one worker and on a cluster of two."""
    options = JobOptions(printers=3)

    async def plan_with_one_worker(state):
        workers = CountingWorkers(tmp_path / "workers", 1)
        try:
            return await plan_job(state, make_job(state, bar, options), workers, ROUNDS_BUDGET_S)
        finally:
            workers.close()

    async def plan_with_two_workers(state):
        job = make_job(state, bar, options)
        pools = {name: CountingWorkers(tmp_path / f"pool-{name}", 1) for name in ("w1", "w2")}
        try:
            async with run_cluster(tmp_path / "cluster", list(pools), pools) as (pool, _):
                result = await plan_job(state, job, pool, ROUNDS_BUDGET_S)
                assert pool.recording_pool.calls == []
            return result
        finally:
            for workers in pools.values():
                workers.close()

    states, plans, max_running_tasks = [], [], []
    for name, make_plan in (("by one", plan_with_one_worker), ("by two", plan_with_two_workers)):
        CountingWorkers.max_running_tasks.clear()
        states.append(StateFolder(tmp_path / name))
        plans.append(asyncio.run(make_plan(states[-1])))
        max_running_tasks.append(CountingWorkers.max_running_tasks[DECOMPOSING_LIMIT.work_name])
    plan_by_one_worker, plan_by_two_workers = plans
    assert plan_by_two_workers == replace(plan_by_one_worker, decomposition=plan_by_two_workers.decomposition)
    assert list_stored_files(states[0]) == list_stored_files(states[1])
    assert max_running_tasks[1] == 2
    attempts = read_attempts(states[0], plan_by_one_worker)
    assert sum(attempt["finished"] for attempt in attempts) >= 3
    assert sum(attempt["makespan_s"] is not None for attempt in attempts) >= 3
    assert read_attempts(states[1], plan_by_two_workers) == attempts
