"""Makes the plan of one job: decompose it in a worker, slice its parts in all of them, level them."""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import TYPE_CHECKING

from farm.compute.worker_pool import DECOMPOSING, SLICING, Workers
from farm.config import PrinterSection
from farm.errors import FarmError
from farm.model import Job, PlanProgress, PlanStep
from farm.paths import StateFolder
from farm.planning.plan import Decomposed, DecomposeTask, Plan, Sliced, make_plan, slice_tasks
from farm.planning.plan_records import SliceTask
from farm.planning.tasks import decompose_job, level_again, plan_gcode, slice_part
from slicing.cache import trim_cache

if TYPE_CHECKING:
    from slicing.plate import PlateResult

log = logging.getLogger(__name__)

_RETRY_S = 5.0  # wall seconds
_LEVELLED = 2  # times at most: what parts take is known well after the first
ROOM_BYTES = 64 * 1024**2
"""Free on the disk of the state folder, without which nobody wonders that a plan fails."""
Done = Callable[[int, "Plan | FarmError"], None]
Progressed = Callable[[int, PlanProgress], None]


class Planner:
    """Makes plans side by side; `done` is told each, or why there is none, and `progressed` how far it is."""

    def __init__(
        self, state: StateFolder, workers: Workers, budget_s: float, done: Done, progressed: Progressed
    ) -> None:
        self._state = state
        self._workers = workers
        self._budget_s = budget_s
        self._done = done
        self._progressed = progressed
        self._tasks: dict[int, asyncio.Task[None]] = {}

    def start(
        self,
        job: Job,
        printers: list[PrinterSection],
        rounds: int,
        factors: Mapping[str, float],
        within_s: float | None = None,
    ) -> None:
        """Begin to plan a job; returns at once.

        Parameters
        ----------
        factors
            What was learned of these printers.
        within_s
            In which it has to be printed; None where nobody said.
        """
        task = DecomposeTask(
            job=job.id,
            model=self._state.files / job.model_file,
            options=job.options,
            printers=tuple(printers),
            rounds=rounds,
            folder=self._state.work / f"job-{job.id}",
            factors=factors,
            within_s=within_s,
            budget_s=self._budget_s,
        )
        self._tasks = {number: making for number, making in self._tasks.items() if not making.done()}
        self._tasks[job.id] = asyncio.get_running_loop().create_task(self._run(job, task))

    def stop(self, job: int | None = None) -> None:
        """Give up that job's plan, or all that are being made."""
        for number, task in self._tasks.items():
            if job in (None, number):
                task.cancel()

    async def _run(self, job: Job, task: DecomposeTask) -> None:
        """Plan a job. What fails on a full disk, whatever it says, is planned again when that has room."""
        while isinstance(result := await self._try(job, task), FarmError) and self._is_full():
            log.error("job %d: %s; it is planned again when %s has room", job.id, result, self._state.root)
            self._progressed(job.id, PlanProgress(step=PlanStep.NO_ROOM))
            while self._is_full():
                await asyncio.sleep(_RETRY_S)
        await self._tell(job.id, result)

    async def _try(self, job: Job, task: DecomposeTask) -> Plan | FarmError:
        try:
            shutil.rmtree(task.folder, ignore_errors=True)
            task.folder.mkdir()
            return await self._plan(job, task)
        except FarmError as error:
            return error
        except Exception as error:
            # Whatever went wrong in one job must not stop the farm: the log has the traceback.
            log.exception("planning job %d", job.id)
            return FarmError(f"planning failed: {type(error).__name__}: {error}; see the daemon's log")
        finally:
            shutil.rmtree(task.folder, ignore_errors=True)

    def _is_full(self) -> bool:
        return shutil.disk_usage(self._state.root).free < ROOM_BYTES

    async def _tell(self, job: int, result: Plan | FarmError) -> None:
        """Hand the plan over; where the books cannot be written (a full disk), until they can.

        What is wrong with a plan so that it cannot be booked is told in its stead: the job fails by it.
        """
        while True:
            try:
                self._done(job, result)
                return
            except FarmError as error:
                log.error("job %d: %s; its plan is kept", job, error)
                await asyncio.sleep(_RETRY_S)
            except Exception as error:
                log.exception("job %d", job)
                if isinstance(result, FarmError):
                    return
                result = FarmError(
                    f"its plan is not taken: {type(error).__name__}: {error}; see the daemon's log"
                )

    async def _plan(self, job: Job, task: DecomposeTask) -> Plan:
        if job.own_gcode is not None:
            return await self._workers.run(plan_gcode, task, self._state.files)
        self._progressed(job.id, PlanProgress(step=PlanStep.DECOMPOSING))
        decomposed = await self._workers.run(decompose_job, task, limit=DECOMPOSING)
        sliced = await self._levelled(await self._sliced(task, decomposed))
        plan = await asyncio.to_thread(make_plan, sliced, self._state.files)
        await asyncio.to_thread(trim_cache, self._state.slices)
        return plan

    async def _levelled(self, sliced: Sliced) -> Sliced:
        """The parts with their cuts moved, as long as the last one, as it is sliced, ends sooner by that."""
        job = sliced.task.job
        for _ in range(_LEVELLED):
            if not sliced.worth_levelling():
                break
            self._progressed(job, PlanProgress(step=PlanStep.LEVELLING))
            folder = sliced.task.folder / "levelled"
            try:
                decomposed = await self._workers.run(level_again, sliced, folder, limit=DECOMPOSING)
                if decomposed is None:
                    break
                moved = await self._sliced(replace(sliced.task, folder=folder), decomposed)
            except FarmError as error:
                log.warning("job %d: its parts are not levelled again: %s", job, error)
                break
            except Exception:  # there is a plan already, whatever is wrong with a better one
                log.exception("job %d: its parts are not levelled again", job)
                break
            if moved.makespan_s() >= sliced.makespan_s():
                break
            sliced = moved
        return sliced

    async def _sliced(self, task: DecomposeTask, decomposed: Decomposed) -> Sliced:
        # Resolving settings and writing files would keep the event loop: both in a thread.
        tasks = await asyncio.to_thread(slice_tasks, task, decomposed, self._state.slices)
        # Longest first: the workers are done soonest then.
        order = sorted(range(len(tasks)), key=lambda i: -decomposed.parts[i].estimated_s)
        results = await self._slice(task.job, [tasks[i] for i in order])
        slices = [result for _, result in sorted(zip(order, results, strict=True), key=itemgetter(0))]
        return Sliced(task, decomposed, tuple(tasks), tuple(slices))

    async def _slice(self, job: int, tasks: list[SliceTask]) -> list[PlateResult]:
        """Slice, and tell how far that is."""
        done = cached = 0

        def tell() -> None:
            progress = PlanProgress(step=PlanStep.SLICING, done=done, of=len(tasks), cached=cached)
            self._progressed(job, progress)

        def one_more(result: PlateResult) -> None:
            nonlocal done, cached
            done += 1
            cached += result.cached
            tell()

        tell()
        return await slice_all(self._workers, tasks, one_more)


async def slice_all(
    workers: Workers, tasks: Sequence[SliceTask], sliced: Callable[[PlateResult], None] = lambda _: None
) -> list[PlateResult]:
    """All workers slice, and `sliced` is told of each; where one fails, or this is cancelled, all end."""

    async def one(task: SliceTask) -> PlateResult:
        result = await workers.run(slice_part, task, limit=SLICING)
        sliced(result)
        return result

    slicing = [asyncio.ensure_future(one(task)) for task in tasks]
    try:
        return await asyncio.gather(*slicing)
    finally:
        for future in slicing:
            future.cancel()
        await asyncio.gather(*slicing, return_exceptions=True)  # until their workers are gone
