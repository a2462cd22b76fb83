"""Effects of the controller's decisions: instructions to agents, the planner and the replan worker."""

from __future__ import annotations

import logging
from typing import Protocol

from drivers.clock import Clock
from farm.agents import AgentManager
from farm.config import Fleet
from farm.model import compute_assembly_ratio
from farm.paths import StateFolder
from farm.planning import JobPlanner, PlanRequest, list_job_files
from farm.planning.replanning import PlateReplanner, ReplanTask, StartReplan
from farm.scheduling import StartPlanning
from farm.state import Books, apply_reels
from farm.state import events as ev
from farm.state.storage import link_files

log = logging.getLogger(__name__)

Effect = ev.AnyInstruction | StartPlanning | StartReplan


class EffectPerformer(Protocol):
    """Performer of effects. It starts them, and does not wait for their completion."""

    def perform(self, effect: Effect, books: Books) -> None:
        """Start an effect; `books` are the committed books."""


class FarmEffectPerformer:
    """Performer of effects with the farm's agents, planner and workers."""

    def __init__(
        self,
        fleet: Fleet,
        state: StateFolder,
        clock: Clock,
        agents: AgentManager,
        planner: JobPlanner,
        plate_replanner: PlateReplanner,
    ) -> None:
        self._fleet, self._state, self._clock = fleet, state, clock
        self._agents, self._planner, self._plate_replanner = agents, planner, plate_replanner

    def perform(self, effect: Effect, books: Books) -> None:
        match effect:
            case StartPlanning():
                self._start_planning(effect, books)
            case StartReplan():
                self._start_replan(effect, books)
            case ev.StopPlanning():
                self._planner.stop(effect.job)
            case ev.LinkFiles():
                self._link_files(effect.job, books)
            case _:
                self._agents.perform(effect, books, self._state.files)

    def _start_planning(self, instruction: StartPlanning, books: Books) -> None:
        job, fleet = books.get_job(instruction.job), apply_reels(self._fleet, books.printers)
        start_s = max(self._clock.now(), job.not_before_s or 0.0)
        deadline_s = job.assembled_by_s if job.done_by_s is None else job.done_by_s
        request = PlanRequest(
            job=job,
            printers=tuple(fleet.find_printer(name) for name in instruction.printers),
            round_count=instruction.round_count,
            time_factors={name: books.get_printer(name).time_factors for name in instruction.printers},
            time_limit_s=None if deadline_s is None else max(0.0, deadline_s - start_s),
            assembly_ratio=compute_assembly_ratio(books.jobs.values()),
            is_quick=instruction.is_quick,
        )
        self._planner.start(request)

    def _start_replan(self, instruction: StartReplan, books: Books) -> None:
        plate, fleet = books.plates[instruction.plate], apply_reels(self._fleet, books.printers)
        (part,) = (books.parts[name] for name in plate.parts)
        job = books.get_job(plate.job)
        task = ReplanTask(
            plate=plate,
            part=part,
            options=job.options,
            printers=tuple(fleet.find_printer(name) for name in instruction.printers),
            files=self._state.files,
            folder=self._state.work / f"replan-{plate.id.replace('/', '-')}",
            time_factors={name: books.get_printer(name).time_factors for name in instruction.printers},
            other_parts=tuple(
                job_part
                for job_part in map(books.parts.__getitem__, job.parts)
                if job_part.id != part.id and job_part.copy_number == part.copy_number
            ),
            reports=tuple(filter(None, (job.decomposition, *job.cuts.values()))),
        )
        self._plate_replanner.start(task, instruction.is_cut)

    def _link_files(self, job_id: int, books: Books) -> None:
        job = books.get_job(job_id)
        names = list_job_files(job, map(books.parts.__getitem__, job.parts), books.list_plates(job))
        try:
            link_files(self._state.find_job_folder(job.id), self._state.files, names)
        except OSError as error:  # the links are optional: the job continues
            log.warning("job %d: its files could not be linked: %s", job.id, error, extra={"job": job.id})
