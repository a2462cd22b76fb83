"""Controller of the farm: the only entry to its state.

The controller runs on one thread, and waits for nothing but the database. Every change goes through
`Controller.handle`: events are applied and committed, the scheduler runs once, and then the effects are
performed.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

from drivers.clock import Clock
from farm.config import Fleet
from farm.control.effects import Effect, EffectPerformer
from farm.control.job_planning import JobPlanning
from farm.control.log_subjects import log_event
from farm.control.scheduler import Scheduler
from farm.control.situations import Situations
from farm.control.telemetry import Telemetry, compare_snapshot, list_unconfirmed_instructions
from farm.errors import FarmError
from farm.log_format import PrinterLog
from farm.model import AgentPrint, AgentSnapshot, Bed, JobState, PrintState
from farm.paths import StateFolder
from farm.planning import Plan
from farm.planning.replanning import ReplanCoordinator, ReplannedPlate
from farm.scheduling import LARGE_FLEET_SIZE, BuildVolumeFinder, ForecastCache, StartRules
from farm.state import (
    Books,
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


class Controller:
    """Controller, which owns the farm's state and makes all decisions; its only I/O is the store.

    Parameters
    ----------
    fleet
        The fleet as configured in `fleet.yaml`.
    store
        Store with the books.
    clock
        The farm's clock.
    find_build_volumes
        Function that returns the boxes in which a printer can print.
    """

    def __init__(
        self, fleet: Fleet, store: Store, clock: Clock, find_build_volumes: BuildVolumeFinder
    ) -> None:
        self.clock, self.started_s = clock, clock.now()
        self.telemetry = Telemetry()
        self.planning = JobPlanning()
        self.is_stopping = False
        self.rules = StartRules.from_config(fleet.fleet)
        self.books = replace(store.load(), outage_window_s=compute_outage_window_s(clock.scale))
        self.fleet = apply_reels(fleet, self.books.printers)
        self._configured_fleet = fleet
        self._store = store
        self._effects: EffectPerformer | None = None
        self._replanning = ReplanCoordinator()
        self.situations = Situations(self, find_build_volumes)
        self.scheduler = Scheduler(
            self.situations, self.planning, self._replanning, self._commit_in_transaction
        )
        self.forecast = ForecastCache(clock, lambda: self.books, self.situations.build_for_forecast)
        self._job_cache = JobCache()

    def start(self, effects: EffectPerformer, restored_s: float | None = None) -> None:
        """Add the new printers of the fleet to the books, and abandon unfinished plans of an earlier daemon.

        Nothing is scheduled yet, because no agent has reported.

        Parameters
        ----------
        effects
            Performer of all effects from now on.
        restored_s
            Time of the backup, if the database was damaged and restored from one.
        """
        self._effects = effects
        events = _list_startup_events(self.books, self.fleet, restored_s, self.clock.now())
        self._perform_effects(self._commit_in_transaction(events))
        self.situations.fill_cache()
        for problem in validate_books(self.books) if restored_s is not None else ():
            log.error("the restored database is inconsistent: %s", problem)

    def handle(self, *events: ev.AnyEvent) -> None:
        """Apply events, commit each, schedule once, and perform the effects.

        Instructions that agents have not confirmed are repeated by the next `tick`, and not here, because the
        time to find them grows with the number of printers.

        Raises
        ------
        StoreError
            If the books cannot be written. The effects of the events committed before are performed.
        """
        self._handle_events(events, ())

    def _handle_events(
        self,
        events: Iterable[ev.AnyEvent],
        repeated_instructions: Iterable[ev.AnyInstruction],
        schedules_now: bool = True,
    ) -> None:
        """Commit events, repeat instructions to agents, and schedule: now, or at the next tick."""
        effects: list[Effect] = []
        self.scheduler.next_change_s = -math.inf
        try:
            instructions = self._schedule() if schedules_now else ()  # a generator: runs after the commits
            for effect in chain(self._commit_events(events), repeated_instructions, instructions):
                effects.append(effect)  # noqa: PERF402  (after an error, the earlier effects are performed)
        finally:
            self._perform_effects(effects)

    def tick(self) -> None:
        """Schedule if a decision may change with time, and repeat unconfirmed instructions to agents."""
        if self.scheduler.has_later_starts:
            self._handle_events((), ())
        elif self.clock.now() >= self.scheduler.next_change_s:
            self._handle_events((), self._list_unconfirmed_instructions(None))
        else:
            self._perform_effects(self._list_unconfirmed_instructions(None))

    @property
    def next_change_s(self) -> float | None:
        """Farm time at which `tick` schedules next; None if only events change decisions."""
        change_s = self.scheduler.next_change_s
        return change_s if math.isfinite(change_s) else None

    def _commit_events(self, events: Iterable[ev.AnyEvent]) -> Iterator[Effect]:
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

    def _commit_in_transaction(self, events: Iterable[ev.AnyEvent]) -> list[Effect]:
        """Commit events in one transaction, with one sync to the disk; if it fails, nothing changes."""
        books = self.books
        try:
            with self._store.transaction():
                return list(self._commit_events(events))
        except BaseException:
            self.books = books
            raise

    def _perform_effects(self, effects: Iterable[Effect]) -> None:
        if self._effects is None:
            raise RuntimeError("the controller has not been started")
        for effect in effects:
            if isinstance(effect, ev.SendStart):
                limits = self.situations.find_limits(effect.print_id)
                effect = effect.model_copy(
                    update={"not_after_s": limits.latest_start_s, "ends_by_s": limits.latest_end_s}
                )
            self._effects.perform(effect, self.books)

    def _schedule(self) -> Iterator[Effect]:
        if not self.is_stopping:
            yield from self.scheduler.run()

    def _list_unconfirmed_instructions(self, names: Iterable[str] | None) -> Iterator[ev.AnyInstruction]:
        """Yield the unconfirmed instructions on open prints, of the named printers or, with None, of all."""
        snapshots, find_printer, now_s = (
            self.telemetry.snapshots,
            self.situations.describe_printer,
            self.clock.now(),
        )
        yield from list_unconfirmed_instructions(
            self.books, snapshots, names, find_printer, self.rules, now_s
        )

    def on_snapshot(self, snapshot: AgentSnapshot) -> None:
        """Handle the changes in an agent's snapshot; the unchanged rest is only stored as telemetry."""
        name = snapshot.printer
        previous_snapshot = self.telemetry.snapshots.get(name)
        is_in_use = self.situations.describe_printer(name) is not None
        changes = compare_snapshot(self.books, snapshot, previous_snapshot, is_in_use, self.clock.now())
        if changes.invalid_transition is not None:  # one faulty agent must not stop the others
            error_with_history = self._store.add_history(changes.invalid_transition)
            PrinterLog(log, name).error("its agent's snapshot does not fit the books: %s", error_with_history)
        has_changed = self.telemetry.store(snapshot, self.clock.now())
        try:
            if changes.events or has_changed:
                schedules_now = len(self.fleet.printers) <= LARGE_FLEET_SIZE
                self._handle_events(
                    changes.events, self._list_unconfirmed_instructions([name]), schedules_now
                )
            else:
                self._perform_effects(self._list_unconfirmed_instructions([name]))
            self._perform_effects(changes.instructions)
        except StoreError as error:
            self.telemetry.reject(snapshot, previous_snapshot, str(error))
            raise

    def on_refusal(self, print_id: str, reason: str, is_late: bool = False) -> None:
        """Count an agent's refusal to start a print; several refusals end the print as failed.

        If the request arrived too late, the print is cancelled at once, and its plate is scheduled again.
        """
        attempt, is_final = self.books.prints[print_id], self.telemetry.count_refusal(print_id)
        if attempt.state is not PrintState.ASSIGNED or not (is_late or is_final):
            return
        printer = self.books.get_printer(attempt.printer)
        self.handle(make_refused_print_end(attempt, printer, reason, is_late, self.clock.now()))

    def find_unreported_since_s(self, printer: str) -> float | None:
        """Return the time since which an agent's prints are unknown; None if all of them are known."""
        return self.books.get_printer(printer).unreported_since_s

    def on_journal(self, snapshot: AgentSnapshot, prints: Sequence[AgentPrint]) -> None:
        """Record the prints made since the backup, from an agent's journal."""
        self.handle(*import_agent_journal(self.books, snapshot, prints, self.clock.now()))

    def on_plan(self, job_id: int, result: Plan | FarmError) -> None:
        """Record the plan of a job, or the error that prevented it."""
        situation = self.situations.build(self.situations.find_held_back_plates())
        event = self.planning.finish(self.books.get_job(job_id), result, self.books, situation)
        self.handle(*([event] if event is not None else []))

    def on_replan(self, plate: str, result: ReplannedPlate | FarmError) -> None:
        """Record the result of replanning a plate, or the error that prevented it."""
        situation = self.situations.build(self.situations.find_held_back_plates())
        event = self._replanning.finish(plate, result, self.books, situation)
        self.handle(*([event] if event is not None else []))

    def on_clock_set(self, step_s: float) -> None:
        """Shift times after the host's clock was set by `step_s` farm seconds; durations stay the same."""
        self.started_s += step_s
        self.forecast.on_clock_set()
        self._replanning.on_clock_set()
        try:
            self.handle(ev.ClockSet(at_s=self.clock.now(), by_s=step_s))
        except StoreError as error:
            log.error("%s", error)

    def warn(self, topic: str, text: str | None) -> None:
        """Store a problem of the farm as a whole (backup, disk) for display; remove it if `text` is None."""
        self.telemetry.warnings[topic] = text

    def build_view_context(self, state: StateFolder) -> ViewContext:
        """Return the current data, from which views are built."""
        ends = self.forecast.find_ends()
        return ViewContext(
            self.fleet,
            self.books,
            self.telemetry.snapshots,
            state,
            self.clock.now(),
            ends_s=ends.ends_by_plate_s,
            forecast_computed_s=ends.at_s,
            awaits_forecast=math.isinf(ends.at_s),
            is_startup_over=not self.situations.is_starting(),
            progress=self.planning.progress,
            warnings=self.telemetry.list_warnings(state.root),
            plate_holds=self.scheduler.find_plate_holds(),
            job_holds=self.planning.holds,
            job_cache=self._job_cache,
        )


def _list_startup_events(
    books: Books, fleet: Fleet, restored_s: float | None, now_s: float
) -> Iterator[ev.AnyEvent]:
    """Yield the events at the start of a daemon.

    Parameters
    ----------
    books, fleet
        The books and the fleet, as loaded.
    restored_s
        Time of the backup, if the database was damaged and restored from one.
    now_s
        Farm time, seconds since the epoch.
    """
    for section in fleet.printers:
        if section.name not in books.printers:
            bed = Bed.UNKNOWN if section.is_simulated else Bed.NOT_CLEAR
            yield ev.PrinterAdded(at_s=now_s, printer=section.name, bed=bed)
    if restored_s is not None:
        yield ev.BooksRestored(at_s=now_s, copied_s=restored_s)
    for job in books.jobs.values():
        if job.state is JobState.PLANNING:
            yield ev.PlanningAbandoned(at_s=now_s, job=job.id, hold=None)
