"""Builder of one plan: decompose, slice, move the cuts to balance the printers, store the files."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from farm.compute import CHECKING_LIMIT, DECOMPOSING_LIMIT, PoolShare
from farm.errors import FarmError
from farm.model import PlanProgress, PlanStep
from farm.paths import StateFolder
from farm.planning.part_records import SliceBatch
from farm.planning.parts.copies import multiply_plan
from farm.planning.parts.drawings import Drawings
from farm.planning.parts.search_rounds import SearchRounds
from farm.planning.plan import DecomposedJob, DecomposeTask, Plan, SlicedJob
from farm.planning.plan_storage import store_plan
from farm.planning.slice_batch import slice_batch
from farm.planning.tasks import plan_gcode, rebalance_parts
from slicing.cache_limit import trim_cache

if TYPE_CHECKING:
    from slicing.plate import PlateResult

log = logging.getLogger(__name__)

_MAX_REBALANCES = 6  # maximum number of times that the cuts of a job are moved
_POLL_INTERVAL_S = 0.5  # wall seconds between two readings of the progress of a decomposition


class PlanBuilder:
    """Builder of the plan of one job; the workers do the computations.

    Parameters
    ----------
    task
        The job, its printers, and a scratch folder.
    workers
        The job's share of the workers.
    state
        The state folder, for the file store and the cache of slices.
    on_progress
        Called with the progress.
    """

    def __init__(
        self,
        task: DecomposeTask,
        workers: PoolShare,
        state: StateFolder,
        on_progress: Callable[[PlanProgress], None],
    ) -> None:
        self.task = task
        self._workers, self._state, self._on_progress = workers, state, on_progress
        self._drawings = Drawings(workers)

    async def plan_gcode(self) -> Plan:
        """Plan a person's own G-code as one plate."""
        self._on_progress(PlanProgress(step=PlanStep.WAITING))
        plan = await self._workers.run(plan_gcode, self.task, self._state.files, limit=CHECKING_LIMIT)
        return multiply_plan(plan, self.task)

    async def plan_model(self) -> Plan:
        """Decompose a model, slice its parts and balance them; idle workers draw them at the same time."""
        try:
            decomposed_job = await self._decompose_model()
            sliced_job = await self._rebalance_job(await self._slice_parts(self.task, decomposed_job))
            await self._drawings.finish(sliced_job.task, sliced_job.decomposed_job)
        finally:
            await self._drawings.stop()
        plan = await asyncio.to_thread(store_plan, sliced_job, self._state.files)
        await asyncio.to_thread(trim_cache, self._state.slices)
        return multiply_plan(plan, self.task)

    async def _decompose_model(self) -> DecomposedJob:
        self._on_progress(PlanProgress(step=PlanStep.WAITING))
        rounds = SearchRounds(self._workers, self.task)
        watch_task = asyncio.get_running_loop().create_task(self._watch_decomposition(rounds))
        try:
            return await rounds.run()
        finally:
            watch_task.cancel()

    async def _watch_decomposition(self, rounds: SearchRounds) -> None:
        """Report each change of the progress that the workers write."""
        last_progress: PlanProgress | None = None
        while True:
            await asyncio.sleep(_POLL_INTERVAL_S)
            progress = await asyncio.to_thread(rounds.read_progress, time.monotonic())
            if progress is None:
                continue
            share = progress.share or None
            current = PlanProgress(step=PlanStep.DECOMPOSING, share=share, remaining_s=progress.remaining_s)
            if current != last_progress:
                last_progress = current
                self._on_progress(current)

    async def _slice_parts(self, task: DecomposeTask, decomposed_job: DecomposedJob) -> SlicedJob:
        """Slice all parts, and report the progress; idle workers draw the parts."""
        sliced_count = cached_count = 0

        def report_progress() -> None:
            progress = PlanProgress(
                step=PlanStep.SLICING, done=sliced_count, of=len(decomposed_job.parts), cached=cached_count
            )
            self._on_progress(progress)

        def count_slice(result: PlateResult) -> None:
            nonlocal sliced_count, cached_count
            sliced_count += 1
            cached_count += result.is_cached
            report_progress()
            if sliced_count < len(decomposed_job.parts) and self._workers.has_idle_worker:
                self._drawings.start(task, decomposed_job)

        report_progress()
        batch = SliceBatch(
            decomposed_job.parts, task.printers, task.options.quality, task.folder, self._state.slices
        )
        return SlicedJob(task, decomposed_job, await slice_batch(self._workers, batch, count_slice))

    async def _rebalance_job(self, sliced_job: SlicedJob) -> SlicedJob:
        """Move the cuts while that may make the slowest printer end sooner; return the fastest result.

        If a part takes longer after a move than estimated, the next move takes that into account.
        """
        job_id, best_job, rounds = sliced_job.task.job, sliced_job, [sliced_job]
        while len(rounds) <= _MAX_REBALANCES and best_job.should_rebalance():
            self._on_progress(PlanProgress(step=PlanStep.REBALANCING))
            folder = sliced_job.task.folder / f"rebalanced-{len(rounds)}"
            try:
                decomposed_job = await self._move_cuts(rounds, best_job, folder)
                if decomposed_job is None:
                    break
                moved_job = await self._slice_parts(replace(sliced_job.task, folder=folder), decomposed_job)
                rounds.append(moved_job)
                if moved_job.compute_makespan_s() >= best_job.compute_makespan_s():
                    await self._drawings.stop(folder)
                    continue
                await self._drawings.finish(moved_job.task, decomposed_job)
            except FarmError as error:
                log.warning("job %d: its cuts are not moved: %s", job_id, error, extra={"job": job_id})
                break
            except Exception:  # the plan is valid without moved cuts
                log.exception("job %d: its cuts are not moved", job_id, extra={"job": job_id})
                break
            await self._drawings.stop(best_job.task.folder)
            best_job = moved_job
        return best_job

    async def _move_cuts(
        self, rounds: Sequence[SlicedJob], best_job: SlicedJob, folder: Path
    ) -> DecomposedJob | None:
        """Move the cuts; meanwhile, idle workers draw the best parts so far, which may be the final ones."""
        move_future = asyncio.ensure_future(
            self._workers.run(rebalance_parts, tuple(rounds), folder, limit=DECOMPOSING_LIMIT)
        )
        try:
            await asyncio.sleep(0)  # lets the move take a worker before the drawings do
            if self._workers.has_idle_worker:
                self._drawings.start(best_job.task, best_job.decomposed_job)
            decomposed_job = await move_future
        finally:
            move_future.cancel()
            await asyncio.gather(move_future, return_exceptions=True)  # waits until its worker has ended
        if decomposed_job is not None and not self._workers.has_idle_worker:  # the new parts need the workers
            await self._drawings.stop(best_job.task.folder)
        return decomposed_job
