"""Makes a waiting plate otherwise, in workers: slices its part for another printer, or cuts it for more."""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable

from farm.compute.worker_pool import SLICING, Limit, Workers
from farm.errors import FarmError
from farm.paths import StateFolder
from farm.planning.job_planner import slice_all
from farm.planning.replanning.replan import (
    ReplannedPlate,
    ReplanTask,
    planned_part,
    recut_plates,
    reslice_tasks,
    resliced_plate,
)
from farm.planning.tasks import cut_part, slice_part

log = logging.getLogger(__name__)

CUTTING = Limit("cutting a part again", 900.0)
Done = Callable[[str, "ReplannedPlate | FarmError"], None]


class ReplanWorker:
    """Works on several plates side by side; `done` is told of each what came of it."""

    def __init__(self, state: StateFolder, workers: Workers, done: Done) -> None:
        self._state, self._workers, self._done = state, workers, done
        self._running: set[asyncio.Task[None]] = set()

    def start(self, task: ReplanTask, cut: bool) -> None:
        """Begin; returns at once."""
        making = asyncio.get_running_loop().create_task(self._run(task, cut))
        self._running.add(making)
        making.add_done_callback(self._running.discard)

    def stop(self) -> None:
        """Give everything up: the next daemon decides anew."""
        for making in self._running:
            making.cancel()

    async def _run(self, task: ReplanTask, cut: bool) -> None:
        result: ReplannedPlate | FarmError
        try:
            shutil.rmtree(task.folder, ignore_errors=True)
            task.folder.mkdir()
            result = await (self._cut(task) if cut else self._slice(task))
        except FarmError as error:
            result = error
        except asyncio.CancelledError:
            return
        except Exception as error:  # the part is printed as it was planned then
            log.exception("plate %s", task.plate.id)
            result = FarmError(f"{type(error).__name__}: {error}")
        finally:
            shutil.rmtree(task.folder, ignore_errors=True)
        try:
            self._done(task.plate.id, result)
        except FarmError as error:  # the books cannot be written: it is looked at again when they can
            log.error("plate %s: %s", task.plate.id, error)

    async def _slice(self, task: ReplanTask) -> ReplannedPlate:
        part = await asyncio.to_thread(planned_part, task)
        (work,) = await asyncio.to_thread(reslice_tasks, task, [part], self._state.slices)
        sliced = await self._workers.run(slice_part, work, limit=SLICING)
        return await asyncio.to_thread(resliced_plate, task, part, work, sliced)

    async def _cut(self, task: ReplanTask) -> ReplannedPlate:
        pieces = await self._workers.run(cut_part, task, limit=CUTTING)
        tasks = await asyncio.to_thread(reslice_tasks, task, pieces.parts, self._state.slices)
        slices = await slice_all(self._workers, tasks)
        return await asyncio.to_thread(recut_plates, task, pieces, tasks, slices)
