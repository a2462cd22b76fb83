"""Scheduler: its runs start plates, replan plates, and begin the planning of jobs."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial

from farm.control.effects import Effect
from farm.control.job_planning import JobPlanning
from farm.control.situations import Situations
from farm.model import Hold
from farm.planning.replanning import ReplanCoordinator
from farm.scheduling import (
    MAX_STARTS,
    Assignment,
    Situation,
    assign_plates,
    find_holds,
    find_next_change_s,
    select_possible_assignments,
)
from farm.state import events as ev

EventCommitter = Callable[[Iterable[ev.AnyEvent]], Collection[Effect]]
"""Function that commits events in one transaction, and returns the resulting effects."""


class Scheduler:
    """Scheduler of the farm, which decides which plates start or are replanned, and which jobs are planned.

    A run assigns plates to all free printers. If there are many, they start in portions, and the farm handles
    messages between the portions. Later portions leave out starts that have since become impossible.
    All other decisions wait for the next run.

    Parameters
    ----------
    situations
        Source of the farm's current situation.
    planning, replanning
        State of the jobs that are being planned, and of the plates that are being replanned.
    commit_in_transaction
        Function that commits the events of decisions.

    Attributes
    ----------
    next_change_s
        Farm time of the next run; minus infinity for the next tick, infinity for the next event.
    """

    def __init__(
        self,
        situations: Situations,
        planning: JobPlanning,
        replanning: ReplanCoordinator,
        commit_in_transaction: EventCommitter,
    ) -> None:
        self.next_change_s = -math.inf
        self._situations, self._commit_in_transaction = situations, commit_in_transaction
        self._planning, self._replanning = planning, replanning
        self._later_starts: Sequence[Assignment] = ()  # starts of the last run that are still to come

    @property
    def has_later_starts(self) -> bool:
        """True if some starts of the last run are still to come."""
        return bool(self._later_starts)

    def run(self) -> Iterator[Effect]:
        """Start the next portion of the last run's plates; if there is none, begin the next run.

        Yields the effects of each decision after the decision is committed.
        """
        starts = self._take_later_starts()
        if starts:
            yield from self._start_plates(starts)
        else:
            yield from self._begin_run()

    def _begin_run(self) -> Iterator[Effect]:
        situations = self._situations
        held_back_plates = situations.find_held_back_plates()
        complete_situation = situations.build(held_back_plates)
        yield from self._replanning.recut_failures(situations.books, complete_situation)
        situation = complete_situation.without(self._replanning.list_holds())
        possible_assignments = assign_plates(situation)
        find_reservations = partial(self._find_reservations, situation)
        revisions = self._planning.revisions
        yield from revisions.revise(situations.books, situation, possible_assignments, find_reservations)
        # While a job is being planned again, it keeps its printers, and no other job may use them.
        revision_holds = revisions.list_holds(situations.books, situation.now_s)
        postponed_plates = revisions.postponed_plates.union(revision_holds)
        allowed_assignments = self._replanning.filter_assignments(situations.books, possible_assignments)
        assignments = [a for a in allowed_assignments if a.plate not in postponed_plates]
        situation = situation.without(revision_holds)
        starts, self._later_starts = assignments[:MAX_STARTS], assignments[MAX_STARTS:]
        yield from self._start_plates(starts)
        if self._later_starts or revisions.postponed_plates:
            self.next_change_s = situation.now_s
            return
        if starts:
            situation = situations.apply_starts(situation, starts)
        yield from self._replanning.reslice_waiting_plates(situations.books, situation)
        yield from self._admit_jobs(situation)
        if revisions.has_remaining_jobs:
            self.next_change_s = situation.now_s
        elif not starts:  # after starts, which change the reserved printers, the next tick schedules again
            self.next_change_s = self._find_next_change_s(situation, held_back_plates)

    def _find_next_change_s(self, situation: Situation, held_back_plates: Mapping[str, Hold]) -> float:
        revision_change_s = self._planning.revisions.next_change_s
        other_times_s = (self._situations.startup_end_s, self._replanning.next_search_s, revision_change_s)
        return find_next_change_s(situation, self._situations.books, held_back_plates, other_times_s)

    def _take_later_starts(self) -> list[Assignment]:
        """Take the next portion of the last run's starts, without those that have become impossible."""
        while self._later_starts:
            portion = self._later_starts[:MAX_STARTS]
            self._later_starts = self._later_starts[MAX_STARTS:]
            situation = self._situations.build_for_assignments(portion)
            holds = self._replanning.list_holds() | self._planning.revisions.list_holds(
                self._situations.books, situation.now_s
            )
            starts = select_possible_assignments(portion, situation.without(holds))
            if starts:
                return starts
        return []

    def _start_plates(self, starts: Sequence[Assignment]) -> Iterator[Effect]:
        """Start plates, and let the next tick schedule again."""
        now_s = self._situations.now_s
        if starts:
            self.next_change_s = now_s
        yield from self._commit_in_transaction(
            ev.PlateAssigned(at_s=now_s, plate=start.plate, printer=start.printer, print_id=uuid.uuid4().hex)
            for start in starts
        )

    def _assign_plates(self, situation: Situation) -> list[Assignment]:
        """Assign plates to printers; only started jobs get printers that are reserved for replans."""
        return self._replanning.filter_assignments(self._situations.books, assign_plates(situation))

    def _admit_jobs(self, situation: Situation) -> Iterator[Effect]:
        books, is_starting = self._situations.books, self._situations.is_starting()
        reserved_printers = self._replanning.reserved_printers
        for event, instruction in self._planning.admit(books, situation, reserved_printers, is_starting):
            yield from self._commit_in_transaction([event])
            if instruction is not None:
                self._planning.begin(instruction, event.at_s)
                yield instruction

    def _find_reservations(self, situation: Situation) -> dict[str, str]:
        reserved_printers = self._replanning.reserved_printers
        return self._planning.find_reservations(self._situations.books, situation, reserved_printers)

    def find_plate_holds(self) -> dict[str, Hold]:
        """Return the current hold of each waiting plate, by plate id."""
        situations = self._situations
        revision_holds = self._planning.revisions.list_holds(situations.books, situations.now_s)
        held_back_plates = situations.find_held_back_plates() | self._replanning.list_holds()
        situation = situations.build_for_display(held_back_plates)
        return held_back_plates | find_holds(situation, self._assign_plates(situation)) | revision_holds

    def list_reservations(self) -> dict[str, str]:
        """Return the free printers that are reserved, each with its purpose."""
        situation = self._situations.build(self._situations.find_held_back_plates())
        assigned_plates = {assignment.plate for assignment in self._assign_plates(situation)}
        return self._find_reservations(situation.without(assigned_plates))
