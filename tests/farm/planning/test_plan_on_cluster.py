"""A job planned by one worker, by two, and on a cluster without a shared disk: same parts, bytes and plan."""

import asyncio
from dataclasses import replace

import pytest
import trimesh

from dask_cluster import cluster
from farm.compute import Workers
from farm.config import Fleet
from farm.model import Job, JobOptions
from farm.paths import StateFolder
from farm.planning.inspection.inspect_submission import inspect_model
from farm.planning.job_planner import JobPlanner
from farm.planning.parts import drawings
from farm.planning.plan import PlanRequest

MODEL = "ultimaker2_plus"
FLEET = Fleet.model_validate(
    {"printers": [{"name": n, "model": MODEL, "port": f"sim://{MODEL}"} for n in "abc"]}
)


async def plan(state, job, pool):
    future = asyncio.get_running_loop().create_future()
    planner = JobPlanner(state, pool, 5.0, lambda _, result: future.set_result(result), lambda *_: None)
    planner.start(PlanRequest(job, FLEET.printers))
    return await future


def make_job(state, path):
    state.make()
    options = JobOptions(engine="guillotine")
    model = inspect_model(path, "bar.stl", options, state.files)
    return Job(id=1, request_id="r" * 8, name="bar", model_file=model.file, options=options, submitted_s=0.0)


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "bar.stl"
    trimesh.creation.box((260.0, 14.0, 12.0)).export(path)
    return path


def plan_here(folder, bar, count):
    """Plan a job by a number of worker processes."""
    state = StateFolder(folder)

    async def main():
        job = make_job(state, bar)
        workers = Workers(folder / "workers", count)
        try:
            return await plan(state, job, workers)
        finally:
            workers.close()

    return state, asyncio.run(main())


def list_stored(state):
    return {file.name for file in state.files.iterdir() if file.suffix != ".json"}


@pytest.fixture(scope="module")
def planned(bar, tmp_path_factory):
    """Plan with one worker; return state folder and plan."""
    return plan_here(tmp_path_factory.mktemp("one") / "state", bar, 1)


@pytest.fixture
def side_by_side(monkeypatch):
    """Draw pictures by several workers also for few parts."""
    monkeypatch.setattr(drawings, "MIN_STEPS", 1)


@pytest.mark.usefixtures("side_by_side")
def test_a_plan_is_the_same_by_one_worker_and_by_two(planned, bar, tmp_path):
    state, by_one = planned
    two, by_two = plan_here(tmp_path / "two", bar, 2)
    assert by_two == replace(
        by_one, decomposition=by_two.decomposition
    )  # it contains the duration of the planning
    assert len(by_two.plates) == 3
    assert list_stored(state) == list_stored(two)


@pytest.mark.usefixtures("side_by_side")
def test_a_plan_is_the_same_here_and_on_a_cluster(planned, bar, tmp_path):
    local_state, local = planned
    remote_state = StateFolder(tmp_path / "there")

    async def main():
        job = make_job(remote_state, bar)
        async with cluster(tmp_path / "cluster", ["w1", "w2"]) as (pool, _):
            remote = await plan(remote_state, job, pool)
            assert pool.own.calls == []
        return remote

    remote = asyncio.run(main())
    assert remote == replace(local, decomposition=remote.decomposition)
    assert list_stored(local_state) == list_stored(remote_state)
    assert not list(remote_state.work.iterdir()) and not list(remote_state.slices.iterdir())
