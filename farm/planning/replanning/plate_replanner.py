"""Replanning of waiting plates in the workers: slice a part for another printer, or cut it for several."""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable

from farm.compute import Limit, Pool, PoolShare
from farm.errors import FarmError
from farm.paths import StateFolder
from farm.planning.part_records import DecomposedPart, SliceBatch, SlicedPart
from farm.planning.replanning.replan import (
    ReplannedPlate,
    ReplanTask,
    copy_part,
    store_recut_part,
    store_resliced_part,
)
from farm.planning.slice_batch import slice_batch
from farm.planning.tasks import cut_part

log = logging.getLogger(__name__)

CUTTING_LIMIT = Limit("recutting a part", 900.0)
ReplanListener = Callable[[str, "ReplannedPlate | FarmError"], None]


class PlateReplanner:
    """Replanner of several plates at the same time.

    Parameters
    ----------
    state
        The state folder.
    workers
        Pool that cuts and slices.
    on_replan
        Called with a plate's id and its replacement, or the error that prevented it.
    """

    def __init__(self, state: StateFolder, workers: Pool, on_replan: ReplanListener) -> None:
        self._state, self._workers, self._on_replan = state, workers, on_replan
        self._running: set[asyncio.Task[None]] = set()

    def start(self, task: ReplanTask, is_cut: bool) -> None:
        """Start replanning a plate, in the background."""
        running_task = asyncio.get_running_loop().create_task(self._replan_plate(task, is_cut))
        self._running.add(running_task)
        running_task.add_done_callback(self._running.discard)

    def stop(self) -> None:
        """Stop replanning all plates; after a restart, the daemon examines them again."""
        for task in self._running:
            task.cancel()

    async def _replan_plate(self, task: ReplanTask, is_cut: bool) -> None:
        result: ReplannedPlate | FarmError
        try:
            shutil.rmtree(task.folder, ignore_errors=True)
            task.folder.mkdir()
            result = await (self._recut_part(task) if is_cut else self._reslice_part(task))
        except FarmError as error:
            result = error
        except asyncio.CancelledError:
            return
        except Exception as error:  # the part is printed as planned
            log.exception("plate %s: replanning failed", task.plate.id, extra={"plate": task.plate.id})
            result = FarmError(f"{type(error).__name__}: {error}")
        finally:
            shutil.rmtree(task.folder, ignore_errors=True)
        try:
            self._on_replan(task.plate.id, result)
        except FarmError as error:  # the books cannot be written: the plate is examined again later
            log.error("plate %s: %s", task.plate.id, error, extra={"plate": task.plate.id})

    async def _reslice_part(self, task: ReplanTask) -> ReplannedPlate:
        part = await asyncio.to_thread(copy_part, task)
        (sliced_part,) = await self._slice_parts(task, (part,))
        return await asyncio.to_thread(store_resliced_part, task, sliced_part)

    async def _recut_part(self, task: ReplanTask) -> ReplannedPlate:
        pieces = await PoolShare(self._workers, task.plate.id).run(cut_part, task, limit=CUTTING_LIMIT)
        sliced_parts = await self._slice_parts(task, pieces.parts)
        return await asyncio.to_thread(store_recut_part, task, pieces, sliced_parts)

    async def _slice_parts(
        self, task: ReplanTask, parts: tuple[DecomposedPart, ...]
    ) -> tuple[SlicedPart, ...]:
        batch = SliceBatch(parts, task.printers, task.options.quality, task.folder, self._state.slices)
        return await slice_batch(PoolShare(self._workers, task.plate.id), batch)
