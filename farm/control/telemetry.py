"""Telemetry of the printers: the agents' latest snapshots in memory, and the resulting events.

A snapshot with new temperatures or progress only replaces the previous one. Events are created only if the
books change, and the scheduler runs only if fields that it reads change.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from farm.model import AgentSnapshot, Link, Temperatures
from farm.scheduling import FleetPrinter, StartRules, may_start_now, select_scheduling_fields
from farm.state import (
    Books,
    detect_alarm,
    handle_unknown_print,
    list_pending_instructions,
    reconcile_idle_printer,
    reconcile_print,
)
from farm.state import events as ev
from farm.state.lifecycles import InvalidTransition
from farm.state.transitions import apply

TEMPERATURE_RETENTION_S = 12 * 3600.0
"""Farm seconds for which temperatures are kept, in memory only."""
MAX_REFUSALS = 5
"""Number of refusals after which a print has failed; an agent also refuses while it opens its port."""
_READING_INTERVAL_S = 60.0
_MIN_C, _MAX_C = -99.0, 999.0  # limits of stored readings, so that noise does not stretch a chart


class Telemetry:
    """Latest snapshot of each agent, the temperatures of the last hours, and current problems.

    Attributes
    ----------
    snapshots
        Latest snapshot of each agent, by printer.
    warnings
        Problems of the farm as a whole (backup, disk), by topic; None for a solved problem.
    """

    def __init__(self) -> None:
        self.warnings: dict[str, str | None] = {}
        self.snapshots: dict[str, AgentSnapshot] = {}
        self._temperatures: dict[str, TemperatureRecord] = {}
        self._refusals = Counter[str]()  # number of refusals of each print
        self._failures: dict[str, str] = {}  # by printer: error in handling its latest snapshot

    def list_warnings(self, root: Path) -> tuple[str, ...]:
        """List the problems of the farm as a whole; those of a full disk name `root`, the state folder."""
        failures = (
            f"{reason}; nothing is recorded until there is space in {root}"
            for reason in self._failures.values()
        )
        return (*islice(failures, 1), *filter(None, self.warnings.values()))

    def list_temperatures(self, printer: str, now_s: float) -> Sequence[Temperatures]:
        """List the temperatures of a printer in the last twelve hours, oldest first."""
        record = self._temperatures.get(printer)
        readings = () if record is None else record.readings
        return tuple(reading for reading in readings if now_s - reading.at_s <= TEMPERATURE_RETENTION_S)

    def store(self, snapshot: AgentSnapshot, now_s: float) -> bool:
        """Store a snapshot; return whether a field that the scheduler reads has changed."""
        self._temperatures.setdefault(snapshot.printer, TemperatureRecord()).add(snapshot, now_s)
        previous_snapshot = self.snapshots.get(snapshot.printer)
        self.snapshots[snapshot.printer] = snapshot
        has_failed = self._failures.pop(snapshot.printer, None) is not None
        return (
            has_failed
            or previous_snapshot is None
            or select_scheduling_fields(previous_snapshot) != select_scheduling_fields(snapshot)
        )

    def reject(self, snapshot: AgentSnapshot, previous_snapshot: AgentSnapshot | None, reason: str) -> None:
        """Record that a snapshot could not be handled, so that the next one is handled in full.

        The link of the previous snapshot is kept, because the loss of a printer is a change of the link.
        """
        self._failures[snapshot.printer] = reason
        if previous_snapshot is None:
            self.snapshots.pop(snapshot.printer, None)
        else:
            self.snapshots[snapshot.printer] = snapshot.model_copy(update={"link": previous_snapshot.link})

    def count_refusal(self, print_id: str) -> bool:
        """Count an agent's refusal to start a print; return whether the limit is reached."""
        self._refusals[print_id] += 1
        return self._refusals[print_id] >= MAX_REFUSALS


class TemperatureRecord:
    """Temperature readings of a printer in the last twelve hours, at most one for each minute.

    The hottest reading of a minute is kept, so that peaks are visible. If the printer does not answer, a
    reading without values is added, which appears as a gap in the chart.
    """

    def __init__(self) -> None:
        self._readings: deque[Temperatures] = deque(maxlen=int(TEMPERATURE_RETENTION_S / _READING_INTERVAL_S))

    @property
    def readings(self) -> Sequence[Temperatures]:
        """Readings, oldest first."""
        return tuple(self._readings)

    def add(self, snapshot: AgentSnapshot, now_s: float) -> None:
        """Add the temperatures of a snapshot.

        Parameters
        ----------
        snapshot
            Report of the printer's agent.
        now_s
            Farm time, seconds since the epoch. Later readings are removed, because the clock was set back.
        """
        readings = self._readings
        while readings and readings[-1].at_s > now_s:
            readings.pop()
        last = readings[-1] if readings else None
        nozzle_c, bed_c = _round_temperature(snapshot.nozzle_c), _round_temperature(snapshot.bed_c)
        if last is not None and nozzle_c is None and bed_c is None and last.nozzle_c is None:
            return  # the gap has already begun
        at_s = now_s
        is_same_minute = last is not None and now_s - last.at_s < _READING_INTERVAL_S
        if last is not None and is_same_minute and (last.nozzle_c is None) == (nozzle_c is None):
            readings.pop()
            at_s = last.at_s
            nozzle_c, bed_c = (
                _find_max_temperature_c(last.nozzle_c, nozzle_c),
                _find_max_temperature_c(last.bed_c, bed_c),
            )
        targets = _round_temperature(snapshot.nozzle_target_c), _round_temperature(snapshot.bed_target_c)
        readings.append(Temperatures(at_s, nozzle_c, bed_c, *targets))


def _round_temperature(degrees_c: float | None) -> int | None:
    return None if degrees_c is None else round(min(_MAX_C, max(_MIN_C, degrees_c)))


def _find_max_temperature_c(first_c: int | None, second_c: int | None) -> int | None:
    readings_c = [degrees_c for degrees_c in (first_c, second_c) if degrees_c is not None]
    return max(readings_c, default=None)


@dataclass(frozen=True, slots=True)
class SnapshotChanges:
    """Changes that result from a snapshot.

    Attributes
    ----------
    events
        Events to commit.
    instructions
        Instructions to the printer's agent.
    invalid_transition
        Error of an event that the books do not allow; this event and later ones are left out.
    """

    events: tuple[ev.AnyEvent, ...]
    instructions: tuple[ev.AnyInstruction, ...]
    invalid_transition: InvalidTransition | None = None


def compare_snapshot(
    books: Books,
    snapshot: AgentSnapshot,
    previous_snapshot: AgentSnapshot | None,
    is_in_use: bool,
    now_s: float,
) -> SnapshotChanges:
    """Compare a snapshot with the books, and derive the changes.

    Parameters
    ----------
    books
        The committed books.
    snapshot, previous_snapshot
        The agent's latest snapshot, and the snapshot before it; None if there was none.
    is_in_use
        True if the printer is in the fleet and enabled.
    now_s
        Farm time, seconds since the epoch.
    """
    comparison = _Comparison(books, snapshot, now_s)
    try:
        comparison.run(previous_snapshot, is_in_use)
    except InvalidTransition as error:
        return SnapshotChanges(tuple(comparison.events), tuple(comparison.instructions), error)
    return SnapshotChanges(tuple(comparison.events), tuple(comparison.instructions))


def list_unconfirmed_instructions(
    books: Books,
    snapshots: Mapping[str, AgentSnapshot],
    names: Iterable[str] | None,
    find_printer: Callable[[str], FleetPrinter | None],
    rules: StartRules,
    now_s: float,
) -> Iterator[ev.AnyInstruction]:
    """Yield the instructions on open prints that agents have not carried out, according to their snapshots.

    A start is sent again only if the print may still start: not during an unconfirmed outage, and not outside
    the allowed hours. If the printer was removed from the fleet, the print keeps its time limit.

    Parameters
    ----------
    books
        The committed books.
    snapshots
        Latest snapshot of each agent, by printer.
    names
        The printers whose open prints are checked; None for all printers.
    find_printer
        Function that describes a printer; it returns None if the printer is no longer enabled.
    rules, now_s
        Rules with the allowed hours, and farm time in seconds since the epoch.
    """
    attempts = books.list_open_prints() if names is None else map(books.find_open_print, names)
    for attempt in [candidate for candidate in attempts if candidate is not None]:
        snapshot = snapshots.get(attempt.printer)
        if snapshot is None:
            continue
        printer = find_printer(attempt.printer)
        if printer is not None:
            latest_end_s = rules.find_latest_end_s(printer, now_s)
        else:
            latest_end_s = None if snapshot.print is None else snapshot.print.ends_by_s
        for instruction in list_pending_instructions(attempt, snapshot, latest_end_s):
            if not isinstance(instruction, ev.SendStart) or (
                books.outage is None
                and printer is not None
                and may_start_now(attempt, books, printer, rules, now_s)
            ):
                yield instruction


class _Comparison:
    """Comparison of a snapshot with a copy of the books, to which each derived event is applied at once."""

    def __init__(self, books: Books, snapshot: AgentSnapshot, now_s: float) -> None:
        self._books, self._snapshot, self._now_s = books, snapshot, now_s
        self.events: list[ev.AnyEvent] = []
        self.instructions: list[ev.AnyInstruction] = []

    def run(self, previous_snapshot: AgentSnapshot | None, is_in_use: bool) -> None:
        snapshot, now_s, name = self._snapshot, self._now_s, self._snapshot.printer
        self._add_results(detect_alarm(self._books.get_printer(name), snapshot, now_s))
        attempt, printer = self._books.find_open_print(name), self._books.get_printer(name)
        if attempt is None:
            if (
                previous_snapshot is not None
                and previous_snapshot.link is Link.READY
                and snapshot.link is Link.ABSENT
            ):
                self._add_results([ev.PrinterLost(at_s=now_s, printer=name)])
            self._add_results(reconcile_idle_printer(self._books.get_printer(name), snapshot, now_s))
        elif attempt.cancel_reason is None and is_in_use and printer.unreported_since_s is not None:
            return  # its agent has not listed its prints since the backup
        else:
            self._add_results(reconcile_print(attempt, snapshot, now_s))
        report = snapshot.print
        if report is not None and (attempt is None or report.print_id != attempt.id):
            recorded_print = self._books.prints.get(report.print_id)
            self._add_results(
                handle_unknown_print(self._books.get_printer(name), recorded_print, snapshot, now_s)
            )

    def _add_results(self, results: Iterable[ev.AnyEvent | ev.AnyInstruction]) -> None:
        for result in results:
            if isinstance(result, ev.Event):
                self._books, _ = apply(result, self._books)
                self.events.append(result)
            else:
                self.instructions.append(result)
