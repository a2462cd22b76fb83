"""Planning of jobs: decompose, slice, move the cuts by the sliced times, record. The work runs in workers.

Submissions are inspected earlier (`inspection`); `planned_event` builds the event that records the plan.
"""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from farm.compute import DECOMPOSING, Workers
from farm.config import PrinterSection
from farm.errors import FarmError
from farm.model import Job, PlanProgress, PlanStep
from farm.paths import StateFolder
from farm.planning.booking import book_plan
from farm.planning.part_records import SliceBatch
from farm.planning.parts.copies import multiply_plan
from farm.planning.plan import DecomposedJob, DecomposeTask, Plan, SlicedJob
from farm.planning.slice_batch import slice_batch
from farm.planning.tasks import decompose_job, plan_gcode, relevel_parts
from slicing.cache import trim_cache

if TYPE_CHECKING:
    from slicing.plate import PlateResult

log = logging.getLogger(__name__)

_RETRY_S = 5.0  # wall seconds
_MOST_RELEVELS = 2  # after the first, the times of the parts are accurate
ROOM_BYTES = 64 * 1024**2
"""Free bytes on the disk of the state folder below which a failure is attributed to a full disk."""
OnPlan = Callable[[int, "Plan | FarmError"], None]
OnProgress = Callable[[int, PlanProgress], None]


class JobPlanner:
    """Plans jobs concurrently.

    Parameters
    ----------
    state
        The state folder.
    workers
        Pool that decomposes and slices.
    budget_s
        Budget of the search for the parts of a job.
    on_plan
        Called with a job's number and its plan, or the error that prevents it.
    on_progress
        Called with a job's number and the progress of its plan.
    """

    def __init__(
        self, state: StateFolder, workers: Workers, budget_s: float, on_plan: OnPlan, on_progress: OnProgress
    ) -> None:
        self._state = state
        self._workers = workers
        self._budget_s = budget_s
        self._on_plan = on_plan
        self._on_progress = on_progress
        self._running: dict[int, asyncio.Task[None]] = {}

    def start(
        self,
        job: Job,
        printers: list[PrinterSection],
        rounds: int,
        time_factors: Mapping[str, float],
        within_s: float | None = None,
    ) -> None:
        """Start planning a job; returns at once.

        Parameters
        ----------
        rounds
            Largest number of parts per printer.
        time_factors
            Time factors of the printers, learned from their prints, by name.
        within_s
            Time within which the job must be printed; None for no limit.
        """
        task = DecomposeTask(
            job=job.id,
            model=self._state.files / job.model_file,
            options=job.options,
            printers=tuple(printers),
            rounds=rounds,
            folder=self._state.work / f"job-{job.id}",
            time_factors=time_factors,
            within_s=within_s,
            budget_s=self._budget_s,
        )
        self._running = {number: running for number, running in self._running.items() if not running.done()}
        self._running[job.id] = asyncio.get_running_loop().create_task(self._run(job, task))

    def stop(self, job: int | None = None) -> None:
        """Stop planning a job, or all jobs."""
        for number, running in self._running.items():
            if job in (None, number):
                running.cancel()

    async def _run(self, job: Job, task: DecomposeTask) -> None:
        """Plan a job; after any error on a full disk, retry when there is space."""
        while isinstance(result := await self._try(job, task), FarmError) and self._is_disk_full():
            log.error("job %d: %s; it is planned when %s has space", job.id, result, self._state.root)
            self._on_progress(job.id, PlanProgress(step=PlanStep.NO_ROOM))
            while self._is_disk_full():
                await asyncio.sleep(_RETRY_S)
        await self._deliver(job.id, result)

    async def _try(self, job: Job, task: DecomposeTask) -> Plan | FarmError:
        try:
            shutil.rmtree(task.folder, ignore_errors=True)
            task.folder.mkdir()
            return await self._plan(job, task)
        except FarmError as error:
            return error
        except Exception as error:
            # An error in one job must not stop the farm: the log has the traceback.
            log.exception("planning job %d", job.id)
            return FarmError(f"planning failed: {type(error).__name__}: {error}; see the daemon's log")
        finally:
            shutil.rmtree(task.folder, ignore_errors=True)

    def _is_disk_full(self) -> bool:
        return shutil.disk_usage(self._state.root).free < ROOM_BYTES

    async def _deliver(self, job: int, result: Plan | FarmError) -> None:
        """Deliver the plan; retry while the books cannot be written (a full disk).

        If it cannot be recorded for another reason, the job fails with that error.
        """
        while True:
            try:
                self._on_plan(job, result)
                return
            except FarmError as error:
                log.error("job %d: %s; its plan is kept", job, error)
                await asyncio.sleep(_RETRY_S)
            except Exception as error:
                log.exception("job %d", job)
                if isinstance(result, FarmError):
                    return
                result = FarmError(
                    f"its plan was refused: {type(error).__name__}: {error}; see the daemon's log"
                )

    async def _plan(self, job: Job, task: DecomposeTask) -> Plan:
        if job.own_gcode is not None:
            return multiply_plan(await self._workers.run(plan_gcode, task, self._state.files), task)
        self._on_progress(job.id, PlanProgress(step=PlanStep.DECOMPOSING))
        decomposed = await self._workers.run(decompose_job, task, limit=DECOMPOSING)
        sliced = await self._slice(task, decomposed)
        levelled = await self._relevel(sliced)
        plan = await asyncio.to_thread(book_plan, levelled, self._state.files)
        await asyncio.to_thread(trim_cache, self._state.slices)
        return multiply_plan(plan, task)

    async def _slice(self, task: DecomposeTask, decomposed: DecomposedJob) -> SlicedJob:
        """Slice all parts, and report the progress."""
        done = cached = 0

        def report_progress() -> None:
            step = PlanProgress(step=PlanStep.SLICING, done=done, of=len(decomposed.parts), cached=cached)
            self._on_progress(task.job, step)

        def count_slice(result: PlateResult) -> None:
            nonlocal done, cached
            done += 1
            cached += result.cached
            report_progress()

        report_progress()
        batch = SliceBatch(
            decomposed.parts, task.printers, task.options.quality, task.folder, self._state.slices
        )
        return SlicedJob(task, decomposed, await slice_batch(self._workers, batch, count_slice))

    async def _relevel(self, sliced: SlicedJob) -> SlicedJob:
        """Move the cuts as long as this shortens the slowest part, by its slice."""
        job = sliced.task.job
        for _ in range(_MOST_RELEVELS):
            if not sliced.should_relevel():
                break
            self._on_progress(job, PlanProgress(step=PlanStep.LEVELLING))
            folder = sliced.task.folder / "levelled"
            try:
                decomposed = await self._workers.run(relevel_parts, sliced, folder, limit=DECOMPOSING)
                if decomposed is None:
                    break
                moved = await self._slice(replace(sliced.task, folder=folder), decomposed)
            except FarmError as error:
                log.warning("job %d: its cuts are not moved: %s", job, error)
                break
            except Exception:  # the plan is valid without moved cuts
                log.exception("job %d: its cuts are not moved", job)
                break
            if moved.makespan_s() >= sliced.makespan_s():
                break
            sliced = moved
        return sliced
