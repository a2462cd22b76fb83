"""A job planned on this computer, and on a cluster without a shared disk: the same parts, bytes and plan."""

import asyncio

import trimesh

from dask_cluster import cluster
from farm.config import Fleet
from farm.model import Job, JobOptions
from farm.paths import StateFolder
from farm.planning.inspection.inspect_submission import inspect_model
from farm.planning.job_planner import JobPlanner
from farm.planning.plan import PlanRequest
from same_process import SameProcess

MODEL = "ultimaker2_plus"
FLEET = Fleet.model_validate(
    {"printers": [{"name": n, "model": MODEL, "port": f"sim://{MODEL}"} for n in "ab"]}
)


async def plan(state, job, pool):
    done = asyncio.get_running_loop().create_future()
    planner = JobPlanner(state, pool, 5.0, lambda _, result: done.set_result(result), lambda *_: None)
    planner.start(PlanRequest(job, FLEET.printers))
    return await done


def make_job(state, path):
    state.make()
    options = JobOptions(engine="guillotine")
    model = inspect_model(path, "bar.stl", options, state.files)
    return Job(id=1, request_id="r" * 8, name="bar", model_file=model.file, options=options, submitted_s=0.0)


def test_a_plan_is_the_same_here_and_on_a_cluster(tmp_path):
    path = tmp_path / "bar.stl"
    trimesh.creation.box((260.0, 14.0, 12.0)).export(path)
    here, there = StateFolder(tmp_path / "here"), StateFolder(tmp_path / "there")

    async def main():
        local = await plan(here, make_job(here, path), SameProcess())
        job = make_job(there, path)
        async with cluster(tmp_path / "cluster", ["w1", "w2"]) as (pool, _):
            remote = await plan(there, job, pool)
            assert pool.own.calls == []
        return local, remote

    local, remote = asyncio.run(main())
    assert remote.parts == local.parts and remote.plates == local.plates
    assert len(remote.plates) == 2
    stored = [
        {file.name for file in state.files.iterdir() if file.suffix != ".json"} for state in (here, there)
    ]
    assert stored[0] == stored[1]
    assert not list(there.work.iterdir()) and not list(there.slices.iterdir())
