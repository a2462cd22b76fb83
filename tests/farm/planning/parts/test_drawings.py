"""Drawings of a job's parts, with their pictures by several workers."""

import asyncio
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from decompose_tasks import decompose_task
from farm.compute import PoolShare
from farm.errors import FarmError
from farm.planning.parts import drawings
from farm.planning.parts.decompose_job import decompose_job
from farm.planning.parts.draw_job import draw_job
from farm.planning.parts.drawings import Drawings, split_steps
from same_process import SameProcess

FILES = ("assembly.png", "assembly.glb", "instructions.html")


@given(st.integers(0, 2000))
def test_each_step_is_drawn_once_in_shares_of_enough_steps(steps):
    ranges = split_steps(steps)
    assert len(ranges) != 1 and len(ranges) <= drawings.MAX_SHARES
    assert [step for first, end in ranges for step in range(first, end)] == list(
        range(steps if ranges else 0)
    )
    assert all(first < end for first, end in ranges)
    assert bool(ranges) == (steps >= 2 * drawings.MIN_STEPS)


class NotingPool(SameProcess):
    """Pool that notes the names of its tasks."""

    def __init__(self):
        self.names = []

    async def run(self, work, *args, limit=None, group=None):
        self.names.append(work.target.rpartition(":")[2])
        await asyncio.sleep(0)
        return work(*args)


def draw(pool, task, cut):
    async def main():
        own = Drawings(PoolShare(pool, 1))
        own.start(task, cut)
        await own.finish(task, cut)

    asyncio.run(main())


@pytest.fixture
def cut(bar, files, tmp_path):
    """Task and parts of a bar that is cut for six printers."""
    task = decompose_task(bar, files, tmp_path, printers=6)
    return task, decompose_job(task)


def test_pictures_by_several_workers_are_the_same(cut, tmp_path, monkeypatch):
    task, decomposed = cut
    assert decomposed.steps >= 2
    monkeypatch.setattr(drawings, "MIN_STEPS", 1)
    draw_job(task, decomposed.drawing_record)
    alone = {name: (task.folder / name).read_bytes() for name in FILES}
    for name in FILES:
        (task.folder / name).unlink()
    pool = NotingPool()
    draw(pool, task, decomposed)
    shares = min(decomposed.steps, drawings.MAX_SHARES)
    assert pool.names == ["draw_overview", *["draw_some_steps"] * shares, "draw_job"]
    assert {name: (task.folder / name).read_bytes() for name in FILES} == alone


def test_few_steps_are_drawn_by_one_worker(cut):
    task, decomposed = cut
    pool = NotingPool()
    draw(pool, task, decomposed)
    assert pool.names == ["draw_job"]


def test_a_share_that_fails_ends_the_others(cut):
    class FailingPool(SameProcess):
        def __init__(self):
            self.open = 0

        async def run(self, work, *args, limit=None, group=None):
            if work.target.endswith("draw_overview"):
                raise FarmError("no room for a picture")
            self.open += 1
            try:
                await asyncio.Event().wait()
            finally:
                self.open -= 1

    task, decomposed = cut
    pool = FailingPool()
    with pytest.raises(FarmError, match="no room for a picture"):
        draw(pool, task, replace(decomposed, steps=40))
    assert pool.open == 0
