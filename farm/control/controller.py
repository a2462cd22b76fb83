"""Controller of the farm: the only entry to its state.

Everything here runs on one thread and never blocks. Every change goes through `Controller.handle`: its events
are applied and committed, the scheduler runs once, and the effects are performed after that.
"""

from __future__ import annotations

import logging
import math
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import chain

from drivers.clock import Clock
from farm.config import Fleet
from farm.control.effects import Effect, Effects
from farm.control.job_planning import JobPlanning
from farm.control.log_subjects import log_event
from farm.control.startup import list_startup_events
from farm.control.telemetry import Telemetry, list_unconfirmed_instructions, read_snapshot
from farm.errors import FarmError
from farm.log_format import PrinterLog
from farm.model import AgentPrint, AgentSnapshot, Hold, HoldCode, PlanProgress, PrintState
from farm.paths import StateFolder
from farm.planning import Plan
from farm.planning.replanning import ReplanCoordinator, ReplannedPlate
from farm.scheduling import (
    LARGE_FLEET,
    MAX_STARTS,
    Assignment,
    BuildVolumes,
    FleetPrinter,
    ForecastCache,
    PlateQueue,
    PrintLimits,
    Situation,
    SituationBuilder,
    StartRules,
    assign_plates,
    count_spares,
    divide_starts,
    find_holds,
    find_next_change_s,
    find_plate_holds,
    find_print_limits,
    update_ends,
)
from farm.state import (
    apply_reels,
    compute_outage_window_s,
    import_agent_journal,
    make_refused_print_end,
    validate_books,
)
from farm.state import events as ev
from farm.state.lifecycles import InvalidTransition
from farm.state.storage import Store, StoreError
from farm.state.transitions import apply
from farm.views import JobCache, ViewContext

log = logging.getLogger(__name__)

PATIENCE_S = 30.0
"""Wall seconds in which printers are expected to connect after the farm has started."""


class Controller:
    """State of the farm and all decisions about it; its only I/O is the store.

    Parameters
    ----------
    fleet
        The fleet of `fleet.yaml`.
    store
        The books.
    clock
        The farm's clock.
    build_volumes
        Function that returns the boxes in which a printer can print.
    """

    def __init__(self, fleet: Fleet, store: Store, clock: Clock, build_volumes: BuildVolumes) -> None:
        self.clock, self.started_s = clock, clock.now()
        self.telemetry = Telemetry()
        self.planning = JobPlanning()
        self.stopping = False
        self.rules = StartRules.from_config(fleet.fleet)
        self.books = replace(store.load(), outage_window_s=compute_outage_window_s(clock.scale))
        self.fleet = apply_reels(fleet, self.books.printers)
        self._configured_fleet = fleet
        self._store, self._situations = store, SituationBuilder(build_volumes)
        self._effects: Effects | None = None
        self._replanning = ReplanCoordinator()
        self.forecast = ForecastCache(clock, lambda: self.books, self.expected_situation)
        self._job_cache = JobCache()
        self._next_change_s = -math.inf  # -inf: schedule at the next tick
        self._later_starts: Sequence[Assignment] = ()  # that the last run left: the next begins with them

    def start(self, effects: Effects, restored_s: float | None = None) -> None:
        """Add printers that are new in the fleet, and abandon the plans of an earlier daemon.

        Nothing is scheduled, as no agent has reported yet.

        Parameters
        ----------
        effects
            Performs the effects of decisions from now on.
        restored_s
            Time of the backup, if the database was damaged and restored from one.
        """
        self._effects = effects
        events = list_startup_events(self.books, self.fleet, restored_s, self.clock.now())
        self._perform(self._commit(events))
        for problem in validate_books(self.books) if restored_s is not None else ():
            log.error("the restored database is inconsistent: %s", problem)

    def handle(self, *events: ev.AnyEvent) -> None:
        """Apply events, commit each, schedule once, and perform the effects.

        Raises
        ------
        StoreError
            If the books cannot be written. The effects of earlier commits are performed.
        """
        self._handle_all(events)

    def _handle_all(
        self, events: Iterable[ev.AnyEvent], printer: str | None = None, at_once: bool = True
    ) -> None:
        """Handle events, repeat instructions to one agent or all, and schedule: now, or at the next tick."""
        effects: list[Effect] = []
        self._next_change_s = -math.inf
        try:
            instructions = self._schedule() if at_once else ()
            for effect in chain(self._commit(events), self._list_unconfirmed(printer), instructions):
                effects.append(effect)  # noqa: PERF402  (after an error, the earlier effects are performed)
        finally:
            self._perform(effects)

    def tick(self) -> None:
        """Schedule if the time has changed a decision; else repeat unconfirmed instructions to agents."""
        if self.clock.now() >= self._next_change_s:
            self.handle()
        else:
            self._perform(self._list_unconfirmed(None))

    @property
    def next_change_s(self) -> float | None:
        """Farm time at which `tick` schedules next; None if only an event changes anything."""
        return self._next_change_s if math.isfinite(self._next_change_s) else None

    def _commit(self, events: Iterable[ev.AnyEvent]) -> Iterator[Effect]:
        """Apply events to the books, commit each, and yield the resulting instructions."""
        for event in events:
            try:
                changed_books, instructions = apply(event, self.books)
            except InvalidTransition as error:
                raise self._store.add_history(error) from None
            self._store.commit(event, self.books, changed_books)
            self.books = changed_books
            if isinstance(event, ev.ReelLoaded):
                self.fleet = apply_reels(self._configured_fleet, changed_books.printers)
            log_event(log, event, changed_books)
            for instruction in instructions:
                if isinstance(instruction, ev.StopPlanning):
                    self.planning.end(instruction.job)
                yield instruction

    def _commit_together(self, events: Iterable[ev.AnyEvent]) -> list[Effect]:
        """Commit events in one transaction, which waits for the disk once; if it fails, nothing changes."""
        books = self.books
        try:
            with self._store.transaction():
                return list(self._commit(events))
        except BaseException:
            self.books = books
            raise

    def _perform(self, effects: Iterable[Effect]) -> None:
        if self._effects is None:
            raise RuntimeError("the controller has not been started")
        for effect in effects:
            if isinstance(effect, ev.SendStart):
                effect = effect.model_copy(update=asdict(self.print_limits(effect.print_id)))
            self._effects.perform(effect, self.books)

    def _schedule(self) -> Iterator[Effect]:
        """Assign plates to printers, and start planning the first jobs of the queue, if possible now."""
        if self.stopping:
            return
        now_s = self.clock.now()
        held_back = self._find_held_back()
        complete_situation = self._build_situation(held_back)
        yield from self._replanning.recut_failures(self.books, complete_situation)
        situation = complete_situation.without(self._replanning.holds())
        reserved_printers = self._replanning.reserved_printers
        find_reservations = partial(self.planning.find_reservations, self.books, situation, reserved_printers)
        yield from self.planning.revisions.revise(self.books, situation, find_reservations)
        revision_holds = self.planning.revisions.holds(self.books, now_s)
        # A job that is planned again keeps its place: no other takes its printers meanwhile.
        assignments, self._later_starts = self._choose_starts(situation)
        assignments = [a for a in assignments if a.plate not in revision_holds]
        situation = situation.without(revision_holds)
        yield from self._commit_together(
            ev.PlateAssigned(at_s=now_s, plate=a.plate, printer=a.printer, print_id=uuid.uuid4().hex)
            for a in assignments
        )
        if self._later_starts:
            self._next_change_s = now_s  # the next tick goes on
            return
        if assignments:
            situation = situation.without({a.plate for a in assignments})
            situation = situation.with_printers(self.fleet_printers())
        yield from self._replanning.reslice_waiting(self.books, situation)
        yield from self._admit_jobs(situation)
        revised_s = self.planning.revisions.next_change_s
        other_times_s = (self._startup_end_s, self._replanning.next_search_s, revised_s)
        self._next_change_s = find_next_change_s(situation, self.books, held_back, other_times_s)
        if assignments:  # a start changes which printers are reserved: the next tick schedules
            self._next_change_s = now_s

    def _assign(self, situation: Situation) -> list[Assignment]:
        """Assign plates to printers; jobs that have not started get none reserved for a replan."""
        return self._replanning.without_reserved(self.books, assign_plates(situation))

    def _choose_starts(self, situation: Situation) -> tuple[list[Assignment], Sequence[Assignment]]:
        """Return the assignments to start now, first those that the last run left, and the later ones."""
        remaining_starts = self._replanning.without_reserved(self.books, self._later_starts)
        starts, later_starts = divide_starts(remaining_starts, situation, MAX_STARTS)
        if not starts:
            return divide_starts(self._assign(situation), situation, MAX_STARTS)
        return starts, later_starts

    def _find_held_back(self) -> dict[str, Hold]:
        """Return the holds of the plates that are excluded from assignment."""
        may_hold = self._situations.may_hold_back
        return find_plate_holds(self.books, self.fleet.printers, self.clock.now(), may_hold)

    def plate_holds(self) -> dict[str, Hold]:
        """Find the current hold of each waiting plate."""
        revision_holds = self.planning.revisions.holds(self.books, self.clock.now())
        held_back = self._find_held_back() | self._replanning.holds()
        situation = self._build_shown_situation(held_back)
        return held_back | find_holds(situation, self._assign(situation)) | revision_holds

    def _admit_jobs(self, situation: Situation) -> Iterator[Effect]:
        reserved_printers = self._replanning.reserved_printers
        for event, order in self.planning.admit(self.books, situation, reserved_printers, self.is_starting()):
            yield from self._commit([event])
            if order is not None:
                self.planning.begin(order, event.at_s)
                yield order

    def list_reservations(self) -> dict[str, str]:
        """Return the free printers that are reserved, each with its purpose."""
        situation = self._build_situation(self._find_held_back())
        assigned_plates = {assignment.plate for assignment in self._assign(situation)}
        reserved_printers = self._replanning.reserved_printers
        return self.planning.find_reservations(
            self.books, situation.without(assigned_plates), reserved_printers
        )

    def _build_situation(self, held_back: Mapping[str, Hold]) -> Situation:
        """Return the current situation, with all waiting plates except those held back."""
        return Situation(
            waiting=self._situations.waiting(self.books),
            printers=self.fleet_printers(),
            rules=self.rules,
            now_s=self.clock.now(),
            time_scale=self.clock.scale,
            spares=count_spares(self.books),
        ).without(held_back)

    def expected_situation(self) -> Situation:
        """Return the situation for the forecast, without plates that are paused."""
        codes, held_back = (HoldCode.PAUSED, HoldCode.STOPPED), self._find_held_back()
        return self._build_shown_situation({n: h for n, h in held_back.items() if h.code in codes})

    def _build_shown_situation(self, held_back: Mapping[str, Hold]) -> Situation:
        """Return the current situation with the ends of running prints that people see."""
        return update_ends(self._build_situation(held_back), self.books, self.telemetry.snapshots)

    def _list_unconfirmed(self, printer: str | None) -> Iterator[ev.AnyInstruction]:
        """Yield the instructions on open prints, of one printer or all, that agents have not confirmed."""
        snapshots, find_situation = self.telemetry.snapshots, self._build_printer_situation
        yield from list_unconfirmed_instructions(self.books, snapshots, printer, find_situation)

    def on_snapshot(self, snapshot: AgentSnapshot) -> None:
        """Handle the changes that an agent's snapshot shows; the rest of it is telemetry."""
        name = snapshot.printer
        previous = self.telemetry.snapshots.get(name)
        in_use = self.fleet_printer(name) is not None
        reading = read_snapshot(self.books, snapshot, previous, in_use, self.clock.now())
        if reading.invalid_transition is not None:  # one faulty agent must not stop the others
            error_with_history = self._store.add_history(reading.invalid_transition)
            PrinterLog(log, name).error("its agent's snapshot does not fit the books: %s", error_with_history)
        has_changed = self.telemetry.store(snapshot, self.clock.now())
        try:
            if reading.events or has_changed:
                self._handle_all(reading.events, name, at_once=len(self.fleet.printers) <= LARGE_FLEET)
            else:
                self._perform(self._list_unconfirmed(name))
            self._perform(reading.instructions)
        except StoreError as error:
            self.telemetry.reject(snapshot, previous, str(error))
            raise

    def on_refusal(self, print_id: str, reason: str, late: bool = False) -> None:
        """Count an agent's refusal to start a print, which has failed after several.

        A request that arrived too `late` is not counted: its plate is scheduled again.
        """
        attempt, is_final = self.books.prints[print_id], self.telemetry.count_refusal(print_id)
        if attempt.state is not PrintState.ASSIGNED or not (late or is_final):
            return
        printer = self.books.printer(attempt.printer)
        self.handle(make_refused_print_end(attempt, printer, reason, late, self.clock.now()))

    def unreported_since_s(self, printer: str) -> float | None:
        """Return the time since which an agent must first list its prints; None if it need not."""
        return self.books.printer(printer).unreported_since_s

    def on_journal(self, snapshot: AgentSnapshot, prints: Sequence[AgentPrint]) -> None:
        """Record the prints that an agent has made since the backup."""
        self.handle(*import_agent_journal(self.books, snapshot, prints, self.clock.now()))

    def on_plan_progress(self, number: int, progress: PlanProgress) -> None:
        """Store the progress of a job's plan."""
        self.planning.on_progress(number, progress)

    def on_plan(self, number: int, result: Plan | FarmError) -> None:
        """Record the plan of a job, or the error that prevents it."""
        situation = self._build_situation(self._find_held_back())
        event = self.planning.finish(self.books.job(number), result, self.books, situation)
        self.handle(*([event] if event is not None else []))

    def on_replan(self, plate: str, result: ReplannedPlate | FarmError) -> None:
        """Record the result of a replan."""
        situation = self._build_situation(self._find_held_back())
        event = self._replanning.finish(plate, result, self.books, situation)
        self.handle(*([event] if event is not None else []))

    def on_clock_set(self, by_s: float) -> None:
        """Handle a step of the host's clock by `by_s` farm seconds: hours shift, durations do not."""
        self.started_s += by_s
        self.forecast.clock_set()
        self._replanning.clock_set()
        try:
            self.handle(ev.ClockSet(at_s=self.clock.now(), by_s=by_s))
        except StoreError as error:
            log.error("%s", error)

    def warn(self, topic: str, text: str | None) -> None:
        """Store a problem of the farm as a whole (backup, disk) for people; None once it is solved."""
        self.telemetry.warnings[topic] = text

    def fleet_printers(self) -> tuple[FleetPrinter, ...]:
        """Describe the enabled printers to the scheduler."""
        return self._situations.printers(self.fleet, self.books, self.telemetry.snapshots)

    def fleet_printer(self, name: str) -> FleetPrinter | None:
        """Describe a printer to the scheduler; None if it is disabled or unknown."""
        return self._situations.printer(self.fleet, name, self.books, self.telemetry.snapshots)

    def print_limits(self, print_id: str) -> PrintLimits:
        """Return the time limits of a print from the attended and quiet hours."""
        attempt = self.books.prints[print_id]
        return find_print_limits(attempt, self.books, self._build_printer_situation(attempt.printer))

    def _build_printer_situation(self, name: str) -> Situation:
        """Return the situation of one printer, if it is enabled, without waiting plates."""
        printer = self.fleet_printer(name)
        return Situation(PlateQueue(), () if printer is None else (printer,), self.rules, self.clock.now())

    @property
    def _startup_end_s(self) -> float:
        return self.started_s + PATIENCE_S * self.clock.scale

    def is_starting(self) -> bool:
        """Return whether the farm has just started: printers that do not answer yet are still expected."""
        return self.clock.now() < self._startup_end_s

    def build_view_context(self, state: StateFolder) -> ViewContext:
        """Return the data that views are built from."""
        ends = self.forecast.find_ends()
        return ViewContext(
            self.fleet,
            self.books,
            self.telemetry.snapshots,
            state,
            self.clock.now(),
            ends_s=ends.by_plate,
            forecast_s=ends.at_s,
            is_started=not self.is_starting(),
            progress=self.planning.progress,
            warnings=self.telemetry.list_warnings(state.root),
            plate_holds=self.plate_holds(),
            job_holds=self.planning.holds,
            jobs=self._job_cache,
        )
