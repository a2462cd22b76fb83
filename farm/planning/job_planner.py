"""Concurrent planning of jobs. The steps of one plan are in `plan_builder`; the work runs in workers.

Submissions are inspected earlier (`inspection`); `planned_event` builds the event that records the plan.
"""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable

from farm.compute import Pool, PoolShare
from farm.errors import FarmError
from farm.model import Job, PlanProgress, PlanStep
from farm.paths import StateFolder
from farm.planning.plan import DecomposeTask, Plan, PlanRequest
from farm.planning.plan_builder import PlanBuilder

log = logging.getLogger(__name__)

_RETRY_INTERVAL_S = 5.0  # wall seconds
MIN_FREE_BYTES = 64 * 1024**2
"""Free bytes on the disk of the state folder below which a failure is attributed to a full disk."""
PlanListener = Callable[[int, "Plan | FarmError"], None]
ProgressListener = Callable[[int, PlanProgress], None]


class JobPlanner:
    """Planner of several jobs at the same time.

    Parameters
    ----------
    state
        The state folder.
    workers
        Pool that decomposes and slices.
    budget_s
        Budget of the search for the parts of a job.
    on_plan
        Called with a job's id and its plan, or the error that prevented it.
    on_progress
        Called with a job's id and the progress of its plan.
    """

    def __init__(
        self,
        state: StateFolder,
        workers: Pool,
        budget_s: float,
        on_plan: PlanListener,
        on_progress: ProgressListener,
    ) -> None:
        self._state = state
        self._workers = workers
        self._budget_s = budget_s
        self._on_plan = on_plan
        self._on_progress = on_progress
        self._running: dict[int, asyncio.Task[None]] = {}

    def start(self, request: PlanRequest) -> None:
        """Start planning a job, in the background."""
        job = request.job
        task = DecomposeTask(
            job=job.id,
            model=self._state.files / job.model_file,
            options=job.options,
            printers=request.printers,
            round_count=request.round_count,
            folder=self._state.work / f"job-{job.id}",
            time_factors=request.time_factors,
            time_limit_s=request.time_limit_s,
            assembly_ratio=request.assembly_ratio,
            budget_s=self._budget_s,
            may_pause=True,
        )
        self._running = {
            job_id: plan_task for job_id, plan_task in self._running.items() if not plan_task.done()
        }
        workers = PoolShare(self._workers, job.id, is_urgent=request.is_quick)
        builder = PlanBuilder(
            task, workers, self._state, lambda progress: self._on_progress(job.id, progress)
        )
        self._running[job.id] = asyncio.get_running_loop().create_task(self._plan_job(job, builder))

    def stop(self, job: int | None = None) -> None:
        """Stop planning a job, or all jobs."""
        for job_id, plan_task in self._running.items():
            if job in (None, job_id):
                plan_task.cancel()

    async def _plan_job(self, job: Job, builder: PlanBuilder) -> None:
        """Plan a job; after an error while the disk is full, retry as soon as there is space."""
        while isinstance(result := await self._build_plan(job, builder), FarmError) and self._is_disk_full():
            log.error(
                "job %d: %s; it will be planned once %s has free space",
                job.id,
                result,
                self._state.root,
                extra={"job": job.id},
            )
            self._on_progress(job.id, PlanProgress(step=PlanStep.NO_ROOM))
            while self._is_disk_full():
                await asyncio.sleep(_RETRY_INTERVAL_S)
        await self._deliver_plan(job.id, result)

    async def _build_plan(self, job: Job, builder: PlanBuilder) -> Plan | FarmError:
        folder = builder.task.folder
        try:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            return await (builder.plan_gcode() if job.own_gcode is not None else builder.plan_model())
        except FarmError as error:
            return error
        except Exception as error:
            # An error in one job must not stop the farm; the log contains the traceback.
            log.exception("job %d: planning failed", job.id, extra={"job": job.id})
            return FarmError(f"planning failed: {type(error).__name__}: {error}; see the daemon's log")
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _is_disk_full(self) -> bool:
        return shutil.disk_usage(self._state.root).free < MIN_FREE_BYTES

    async def _deliver_plan(self, job: int, result: Plan | FarmError) -> None:
        """Deliver the plan; retry while the books cannot be written, for example because the disk is full.

        If it cannot be recorded for another reason, the job fails with that error.
        """
        while True:
            try:
                self._on_plan(job, result)
                return
            except FarmError as error:
                log.error(
                    "job %d: %s; its plan is kept until it can be recorded", job, error, extra={"job": job}
                )
                await asyncio.sleep(_RETRY_INTERVAL_S)
            except Exception as error:
                log.exception("job %d: its plan cannot be recorded", job, extra={"job": job})
                if isinstance(result, FarmError):
                    return
                result = FarmError(
                    f"its plan cannot be recorded: {type(error).__name__}: {error}; see the daemon's log"
                )
