"""The one event loop's heart: events in, books committed, instructions out.

Everything here runs on one thread and never waits. `happened` is the only way in which the books change:
event, new state, commit, and only then what follows from it.
"""

from __future__ import annotations

import logging
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from drivers.clock import Clock
from farm.config import Fleet, PrinterSection
from farm.control.admission import JobAdmission
from farm.control.forecast_cache import ForecastCache
from farm.errors import FarmError
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    Bed,
    Hold,
    Job,
    JobOptions,
    JobState,
    Link,
    PlanProgress,
    Plate,
    Print,
    PrintState,
)
from farm.paths import StateFolder
from farm.planning.plan import InspectedSubmission, Plan, TooFewPrinters
from farm.planning.planned_event import planned_event
from farm.planning.replanning.coordinator import ReplanCoordinator
from farm.planning.replanning.replan import ReplannedPlate
from farm.scheduling.assign import assign
from farm.scheduling.matching import FleetPrinter
from farm.scheduling.situation import Situation
from farm.scheduling.situation_builder import (
    Rooms,
    Span,
    describe_plates,
    describe_printers,
    may_begin,
    own_holds,
    span,
)
from farm.scheduling.spares import spare_printers
from farm.scheduling.start_rules import StartRules
from farm.scheduling.time_expressions import start_and_deadline_s
from farm.state import events as ev
from farm.state.lifecycles import InvalidTransition
from farm.state.outage import window_s
from farm.state.reconcile import (
    detect_alarm,
    handle_unknown_print,
    observe_idle_printer,
    pending_instructions,
    reconcile,
    refused_print_end,
)
from farm.state.recovery.journal_import import import_agent_journal
from farm.state.reels import fleet_with_reels
from farm.state.storage.store import Store, StoreError
from farm.state.transitions import apply
from farm.state.validate import validate
from farm.views.context import ViewContext

log = logging.getLogger(__name__)

PATIENCE_S = 30.0
"""Wall seconds in which printers are expected to connect after the farm has started."""
REFUSALS = 5
"""How often an agent may refuse to start a print; a port that is just opening refuses too."""


class Hands(Protocol):
    """What carries out instructions: it starts things and returns at once."""

    def perform(self, instruction: ev.AnyInstruction) -> None: ...

    def plan(self, job: Job, printers: list[PrinterSection], rounds: int) -> None: ...

    def replan(self, plate: Plate, printers: list[PrinterSection], cut: bool) -> None: ...


class Core:
    """The farm's state and its rules, without any I/O but the store's."""

    def __init__(
        self,
        fleet: Fleet,
        store: Store,
        clock: Clock,
        rooms: Rooms,
        hands: Hands,
    ) -> None:
        self._written = fleet
        self.clock = clock
        self.since_s = clock.now()
        self.snapshots: dict[str, AgentSnapshot] = {}
        self.progress: dict[int, PlanProgress] = {}
        self.stopping = False
        self._warning: str | None = None  # what is wrong with the farm itself, for a person
        self._unbooked: dict[str, str] = {}  # by printer: why its agent's last word is not in the books
        self._store = store
        self._room = rooms
        self.rules = StartRules.of(fleet.fleet)
        self._hands = hands
        self._admission = JobAdmission(self, hands.plan)
        self._forecast_cache = ForecastCache(self.rules, clock.scale)
        self._replanning = ReplanCoordinator(clock, self._start_replan)
        self._refusals: Counter[str] = Counter()
        self.books = replace(store.load(), outage_window_s=window_s(clock.scale))
        self.fleet = fleet_with_reels(fleet, self.books.printers)

    # -- events -----------------------------------------------------------------------------------------

    def happened(self, *happenings: ev.AnyEvent) -> None:
        """Take events into the books, commit each, and carry out what follows."""
        for event in happenings:
            try:
                after, instructions = apply(event, self.books)
            except InvalidTransition as error:
                raise self._store.tell_story(error) from None
            self._store.commit(event, self.books, after)
            self.books = after
            if isinstance(event, ev.ReelLoaded):
                self.fleet = fleet_with_reels(self._written, after.printers)
            log.info(
                "%s %s", type(event).__name__, event.model_dump_json(exclude={"at_s"}, exclude_none=True)
            )
            for instruction in instructions:
                if isinstance(instruction, ev.StopPlanning):
                    self._no_longer_planned(instruction.job)
                self._hands.perform(instruction)

    def start(self, restored_s: float | None = None) -> None:
        """Bring yesterday's books in line with today's fleet, and give up plans that died with a daemon.

        `restored_s` is when the books were copied, where they are a copy because they were damaged.
        """
        now_s = self.clock.now()
        for section in self.fleet.printers:
            if section.name not in self.books.printers:
                bed = Bed.UNKNOWN if section.simulated else Bed.NOT_CLEAR
                self.happened(ev.PrinterAdded(at_s=now_s, printer=section.name, bed=bed))
        if restored_s is not None:
            self.happened(ev.BooksRestored(at_s=now_s, copied_s=restored_s))
            for problem in validate(self.books):
                log.error("the books that were restored do not agree with themselves: %s", problem)
        for job in list(self.books.jobs.values()):
            if job.state is JobState.PLANNING:
                self.happened(ev.PlanningAbandoned(at_s=now_s, job=job.id, hold=None))

    def unreported_since_s(self, printer: str) -> float | None:
        """From when on an agent has to say what it printed before its word counts; None: it need not."""
        return self.books.printer(printer).unreported_since_s

    def recounted(self, snapshot: AgentSnapshot, prints: Sequence[AgentPrint]) -> None:
        """An agent said what it printed since the books were copied."""
        self.happened(*import_agent_journal(self.books, snapshot, prints, self.clock.now()))

    def heard(self, snapshot: AgentSnapshot) -> None:
        """An agent said how things are."""
        before = self.snapshots.get(snapshot.printer)
        try:
            try:
                self._book(snapshot, before)
            except InvalidTransition as error:  # whatever an agent says, the others go on
                log.error("%s: its agent's word does not fit the books: %s", snapshot.printer, error)
            self.snapshots[snapshot.printer] = snapshot
            self.settle()
        except StoreError as error:
            self._unbooked[snapshot.printer] = str(error)
            if before is not None:  # a person sees how hot it is; all else is news when said again
                self.snapshots[snapshot.printer] = snapshot.model_copy(update={"link": before.link})
            raise
        self._unbooked.pop(snapshot.printer, None)

    def _book(self, snapshot: AgentSnapshot, before: AgentSnapshot | None) -> None:
        """Bring the books in line with an agent's word."""
        now_s = self.clock.now()
        self.happened(*detect_alarm(self.books.printer(snapshot.printer), snapshot, now_s))
        attempt = self.books.open_print_on(snapshot.printer)
        if attempt is not None:
            wanted = attempt.cancel_reason is None and self.view(snapshot.printer) is not None
            if wanted and self.unreported_since_s(snapshot.printer) is not None:
                return  # there is no agent now that could tell what became of it
            self.happened(*reconcile(attempt, snapshot, now_s))
        else:
            if before is not None and before.link is Link.READY and snapshot.link is Link.ABSENT:
                self.happened(ev.PrinterLost(at_s=now_s, printer=snapshot.printer))
            self.happened(*observe_idle_printer(self.books.printer(snapshot.printer), snapshot, now_s))
        said = snapshot.print
        if said is not None and (attempt is None or said.print_id != attempt.id):
            printer = self.books.printer(snapshot.printer)
            known = self.books.prints.get(said.print_id)
            for follows in handle_unknown_print(printer, known, snapshot, now_s):
                if isinstance(follows, ev.Event):
                    self.happened(follows)
                else:
                    self._hands.perform(follows)

    def clock_set(self, by_s: float) -> None:
        """The host's clock was set, and `clock` follows it: hours are others, spans go on.

        `by_s` are the farm seconds by which it is ahead of what it was.
        """
        self.since_s += by_s
        self._forecast_cache.clock_set()
        self._replanning.clock_set()
        try:
            self.happened(ev.ClockSet(at_s=self.clock.now(), by_s=by_s))
            self.settle()
        except StoreError as error:
            log.error("%s", error)

    # -- decisions --------------------------------------------------------------------------------------

    def settle(self) -> None:
        """Give plates to printers, and begin the job in front, as far as both can be done now."""
        self._remind()
        if self.stopping:
            return
        now_s = self.clock.now()
        held_back = own_holds(self.books, self.fleet.printers, now_s)
        offered = self._situation(held_back)
        self._replanning.recut_failures(self.books, offered)
        held_back |= self._replanning.holds()
        waiting = tuple(plate for plate in offered.waiting if plate.id not in held_back)
        situation = offered.with_waiting(waiting)
        given, holds = assign(situation)
        for assignment in given:
            self.happened(
                ev.PlateAssigned(
                    at_s=now_s, plate=assignment.plate, printer=assignment.printer, print_id=uuid.uuid4().hex
                )
            )
        news = {
            name: hold for name, hold in (holds | held_back).items() if self.books.plates[name].hold != hold
        }
        if news:
            self.happened(ev.PlatesHeld(at_s=now_s, holds=dict(news)))
        if holds:
            kept = spare_printers(situation.printers, situation.planned, situation.spares)
            after = situation.with_printers(tuple(self.fleet_printers()))
            self._replanning.reslice_waiting(self.books, after, holds, kept)
        self._admission.settle(holds, self._replanning.reserved_printers)

    def _situation(self, held_back: Mapping[str, Hold]) -> Situation:
        """Describe this moment to the scheduler, with all waiting plates but those held back."""
        waiting = (plate for plate in self.books.waiting_plates() if plate.id not in held_back)
        return Situation(
            waiting=tuple(describe_plates(waiting, self.books)),
            printers=tuple(self.fleet_printers()),
            rules=self.rules,
            now_s=self.clock.now(),
            time_scale=self.clock.scale,
            spares=self.spares(),
        )

    def _start_replan(self, plate: Plate, printers: tuple[str, ...], cut: bool) -> None:
        self._hands.replan(plate, [self.fleet.printer(name) for name in printers], cut)

    def replanned(self, plate: str, result: ReplannedPlate | FarmError) -> None:
        """Book what a replan came to, and schedule."""
        offered = self._situation(own_holds(self.books, self.fleet.printers, self.clock.now()))
        event = self._replanning.finish(plate, result, self.books, offered)
        if event is not None:
            self.happened(event)
        self.settle()

    def _remind(self) -> None:
        """Tell agents again what they were told while they were away, and when hours have changed."""
        for attempt in list(self.books.open_prints()):
            snapshot = self.snapshots.get(attempt.printer)
            if snapshot is not None:
                for instruction in pending_instructions(attempt, snapshot, self._ends_by_s(snapshot)):
                    if isinstance(instruction, ev.SendStart) and not self._may_begin(attempt):
                        continue
                    self._hands.perform(instruction)

    def _ends_by_s(self, snapshot: AgentSnapshot) -> float | None:
        """When what is printed there has to be ended; as it was told, where it has left the fleet since."""
        view, said = self.view(snapshot.printer), snapshot.print
        if view is None:
            return None if said is None else said.ends_by_s
        return self.rules.ends_by_s(view, self.clock.now())

    def _may_begin(self, attempt: Print) -> bool:
        """Nothing heats in an outage that nobody has confirmed, nor out of hours."""
        views, now_s = self.fleet_printers(), self.clock.now()
        return self.books.outage is None and may_begin(attempt, self.books, views, self.rules, now_s)

    def span(self, print_id: str) -> Span:
        """When hours let a print begin and go on."""
        views, now_s = self.fleet_printers(), self.clock.now()
        return span(self.books.prints[print_id], self.books, views, self.rules, now_s)

    def view(self, printer: str) -> FleetPrinter | None:
        """A printer as the scheduler sees it; None where it is not used."""
        sections = [section for section in self.fleet.printers if section.name == printer]
        views = describe_printers(sections, self.books, self.snapshots, self._room)
        return views[0] if views else None

    def refused(self, print_id: str, reason: str, late: bool = False) -> None:
        """An agent would not start a print; where it still will not after several times, the print failed.

        One that came too `late` was never begun, and its plate is given a printer by what holds now.
        """
        attempt = self.books.prints[print_id]
        self._refusals[print_id] += 1
        if attempt.state is not PrintState.ASSIGNED or not (late or self._refusals[print_id] >= REFUSALS):
            return
        printer = self.books.printer(attempt.printer)
        self.happened(refused_print_end(attempt, printer, reason, late, self.clock.now()))
        self.settle()

    def spares(self) -> int:
        """How many printers are kept for what fails while nobody is there, by the jobs that are printed."""
        if self.rules.is_attended(self.clock.now()):
            return 0
        jobs = self.books.jobs.values()
        return max((job.options.spares for job in jobs if job.state is JobState.PRINTING), default=0)

    def next_edge_s(self) -> float | None:
        """When hours or start times next change what may start; None where they never do."""
        now_s = self.clock.now()
        starts = (j.not_before_s for j in self.books.jobs.values() if not j.state.ended and j.not_before_s)
        edges = [self.rules.attended.edge_s(now_s), self.rules.quiet.edge_s(now_s), *starts]
        return min((edge for edge in edges if edge is not None and edge > now_s), default=None)

    def progressed(self, number: int, progress: PlanProgress) -> None:
        """The planner is so far with a job."""
        self.progress[number] = progress

    def planned(self, number: int, result: Plan | FarmError) -> None:
        """A plan was made, or could not be made."""
        now_s = self.clock.now()
        self._no_longer_planned(number)
        job = self.books.job(number)
        if job.state is not JobState.PLANNING:
            return  # cancelled meanwhile
        if isinstance(result, TooFewPrinters):
            self._admission.needs(number, result.needed)
            self.happened(ev.PlanningAbandoned(at_s=now_s, job=number, hold=None))
        elif isinstance(result, FarmError):
            self.happened(ev.JobFailed(at_s=now_s, job=number, error=result.code, reason=str(result)))
        else:
            made = planned_event(job, result, self.fleet_printers(), self.books, self.rules, now_s)
            self.happened(made)
        self.settle()

    def _no_longer_planned(self, number: int) -> None:
        self.progress.pop(number, None)
        self._admission.planned(number)

    # -- jobs -------------------------------------------------------------------------------------------

    def submitted(self, request_id: str) -> int | None:
        """The job that this request made, if it was heard before."""
        return next((job.id for job in self.books.jobs.values() if job.request_id == request_id), None)

    def submit(
        self,
        request_id: str,
        name: str,
        model: InspectedSubmission,
        options: JobOptions,
        by: str | None = None,
    ) -> tuple[int, bool]:
        """Take a job; the same request id gives the same job. Returns its number, and whether it is old."""
        known = self.submitted(request_id)
        if known is not None:
            return known, True
        number = max(self.books.jobs, default=0) + 1
        now_s = self.clock.now()
        not_before_s, done_by_s = start_and_deadline_s(options, self.rules, now_s)
        if self.fleet.fleet.approve:
            options = options.model_copy(update={"hold": True})
        job = Job(
            id=number,
            request_id=request_id,
            name=name,
            model_file=model.file,
            options=options,
            own_gcode=model.own_gcode,
            repairs=model.repairs,
            scale=model.scale,
            not_before_s=not_before_s,
            done_by_s=done_by_s,
            submitted_s=now_s,
            submitted_by=by,
        )
        self.happened(ev.JobSubmitted(at_s=now_s, job=job))
        self.settle()
        return number, False

    def abort_all(self) -> None:
        """End every job that is being printed."""
        for number in sorted({attempt.job for attempt in self.books.open_prints()}):
            if not self.books.job(number).state.ended:
                self.happened(ev.JobCancelled(at_s=self.clock.now(), job=number))
        for attempt in list(self.books.open_prints()):  # of a part that a person has found whole meanwhile
            if attempt.cancel_reason is None:
                self.happened(ev.PlateCancelled(at_s=self.clock.now(), plate=attempt.plate, by=ev.A_PERSON))

    def copied(self, trouble: str | None) -> None:
        """The books were copied, or why they could not be."""
        self._warning = trouble

    # -- views ------------------------------------------------------------------------------------------

    def fleet_printers(self) -> list[FleetPrinter]:
        return describe_printers(self.fleet.printers, self.books, self.snapshots, self._room)

    def build_view_context(self, state: StateFolder) -> ViewContext:
        """All that a view is drawn from."""
        now_s = self.clock.now()
        unbooked = next(iter(self._unbooked.values()), None)
        if unbooked is not None:
            unbooked += f"; nothing is booked until there is room in {state.root}"
        return ViewContext(
            self.fleet,
            self.books,
            self.snapshots,
            state,
            now_s,
            ends_s=self._forecast_cache.ends_s(self.books, self.fleet_printers, now_s),
            startup_over=not self.arriving(),
            progress=self.progress,
            warning=unbooked or self._warning,
        )

    def arriving(self) -> bool:
        """Whether the farm has just started: printers that do not answer yet are still expected."""
        return self.clock.now() - self.since_s < PATIENCE_S * self.clock.scale
