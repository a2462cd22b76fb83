"""Drawings of a job's parts, whose pictures are drawn by several workers."""

import asyncio
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.decompose_tasks import make_decompose_task
from clusters.same_process import SameProcess
from farm.compute import PoolShare
from farm.errors import FarmError
from farm.planning.parts import drawings
from farm.planning.parts.decompose_job import decompose_job
from farm.planning.parts.drawings import Drawings, split_steps
from farm.planning.parts.job_drawing import draw_job_parts

FILES = ("assembly.png", "assembly.glb", "instructions.html")


@given(st.integers(0, 2000))
def test_each_step_is_drawn_once_in_shares_of_enough_steps(steps):
    ranges = split_steps(steps)
    assert len(ranges) != 1 and len(ranges) <= drawings.MAX_RANGES
    assert [step for first_step, end in ranges for step in range(first_step, end)] == list(
        range(steps if ranges else 0)
    )
    assert all(first_step < end for first_step, end in ranges)
    assert bool(ranges) == (steps >= 2 * drawings.MIN_STEPS)


class RecordingPool(SameProcess):
    """Pool that records the names of its tasks."""

    def __init__(self):
        self.names = []

    async def run(self, work, *args, limit=None, group=None):
        self.names.append(work.target.rpartition(":")[2])
        await asyncio.sleep(0)
        return work(*args)


def draw_parts(pool, task, decomposition):
    async def main():
        drawings = Drawings(PoolShare(pool, 1))
        drawings.start(task, decomposition)
        await drawings.finish(task, decomposition)

    asyncio.run(main())


@pytest.fixture
def cut_bar(bar, files, tmp_path):
    """Cut a bar for six printers; return task and parts."""
    task = make_decompose_task(bar, files, tmp_path, printers=6)
    return task, decompose_job(task)


def test_pictures_by_several_workers_equal_those_by_one(cut_bar, tmp_path, monkeypatch):
    task, result = cut_bar
    assert result.step_count >= 2
    monkeypatch.setattr(drawings, "MIN_STEPS", 1)
    draw_job_parts(task, result.drawing_record)
    pictures = {name: (task.folder / name).read_bytes() for name in FILES}
    for name in FILES:
        (task.folder / name).unlink()
    pool = RecordingPool()
    draw_parts(pool, task, result)
    shares = min(result.step_count, drawings.MAX_RANGES)
    assert pool.names == ["draw_overview", *["draw_step_range"] * shares, "draw_job_parts"]
    assert {name: (task.folder / name).read_bytes() for name in FILES} == pictures


def test_few_steps_are_drawn_by_one_worker(cut_bar):
    task, result = cut_bar
    pool = RecordingPool()
    draw_parts(pool, task, result)
    assert pool.names == ["draw_job_parts"]


def test_share_that_fails_ends_the_others(cut_bar):
    class FailingPool(SameProcess):
        def __init__(self):
            self.open_task_count = 0

        async def run(self, work, *args, limit=None, group=None):
            if work.target.endswith("draw_overview"):
                raise FarmError("no room for a picture")
            self.open_task_count += 1
            try:
                await asyncio.Event().wait()
            finally:
                self.open_task_count -= 1

    task, result = cut_bar
    pool = FailingPool()
    with pytest.raises(FarmError, match="no room for a picture"):
        draw_parts(pool, task, replace(result, step_count=40))
    assert pool.open_task_count == 0
