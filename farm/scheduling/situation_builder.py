"""Description of fleet, books and the agents' latest snapshots for the scheduler.

Pure, but for the memory of `SituationBuilder`: what has not changed is not described again.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

from drivers.printers import PROFILES
from farm.config import PrinterSection
from farm.model import AgentSnapshot, Job, JobState, Link, Plate, Print, Printer, PrintState
from farm.scheduling.matching import Box, Capabilities, FleetPrinter, Requirements, WaitingPlate
from farm.scheduling.plate_holds import may_hold_back
from farm.scheduling.situation import Situation
from farm.state.books import Books
from farm.state.plate_state import PlateState

BuildVolumes = Callable[[PrinterSection], tuple[Box, ...]]


def _describe_printer(
    section: PrinterSection,
    books: Books,
    said: AgentSnapshot | None,
    attempt: Print | None,
    rooms: BuildVolumes,
) -> FleetPrinter:
    entry = books.printer(section.name)
    attention_reason = entry.attention_reason
    if said is not None and said.link is Link.FAULT and attention_reason is None:
        attention_reason = said.reason or "its agent reports a fault"
    verified = said is None or said.reset_verified
    return FleetPrinter(
        name=section.name,
        capabilities=Capabilities(
            rooms(section), section.material, section.colour, section.nozzle_mm, PROFILES[section.model].kin
        ),
        bed=entry.bed,
        filament=entry.filament,
        link=said.link if said is not None else Link.STARTING,
        booked=attempt is not None,
        attention_reason=attention_reason,
        maintenance=entry.maintenance,
        heating=attempt is not None and attempt.state in (PrintState.ASSIGNED, PrintState.HEATING),
        free_s=None if attempt is None else _expected_end_s(books, attempt, entry.time_factor),
        job=None if attempt is None else attempt.job,
        heats_until_s=None if attempt is None else _begun_s(attempt) + books.plates[attempt.plate].prelude_s,
        grams=_free_grams(books, entry, attempt),
        reel_doubted=entry.reel is not None and entry.reel.doubted,
        time_factor=entry.time_factor,
        unattended=section.unattended and verified,
        why_attended="fleet.yaml says so" if verified else "its board was not seen to reset",
    )


def _free_grams(books: Books, entry: Printer, attempt: Print | None) -> float | None:
    """Return the grams on a reel that its print, where there is one, leaves; None where nobody said."""
    if entry.reel is None or entry.reel.grams is None or attempt is None:
        return None if entry.reel is None else entry.reel.grams
    return max(0.0, entry.reel.grams - books.plates[attempt.plate].grams)


def _begun_s(attempt: Print) -> float:
    return attempt.started_s if attempt.started_s is not None else attempt.assigned_s


def _expected_end_s(books: Books, attempt: Print, factor: float) -> float:
    """Return when a print should end by its plate's time: in whole minutes, so that it changes seldom."""
    return math.ceil((_begun_s(attempt) + books.plates[attempt.plate].expected_on(factor)) / 60) * 60.0


class SituationBuilder:
    """Describes one moment after the other to the scheduler.

    Parameters
    ----------
    rooms
        Gives the boxes that a printer of a section can print in.
    """

    def __init__(self, rooms: BuildVolumes) -> None:
        self._rooms = rooms
        self._printers: dict[str, tuple[tuple[object, ...], FleetPrinter]] = {}
        self._jobs: dict[int, tuple[object, _JobPlates]] = {}

    def printers(
        self, sections: Iterable[PrinterSection], books: Books, snapshots: Mapping[str, AgentSnapshot]
    ) -> tuple[FleetPrinter, ...]:
        """Describe the printers that may be used."""
        return tuple(
            self._printer(section, books, snapshots.get(section.name))
            for section in sections
            if section.enabled
        )

    def _printer(self, section: PrinterSection, books: Books, said: AgentSnapshot | None) -> FleetPrinter:
        entry, attempt = books.printer(section.name), books.open_print_on(section.name)
        heard = None if said is None else availability(said)
        before, described = self._printers.get(section.name, ((), None))
        if (
            described is not None
            and before[0] is section
            and before[1] is entry
            and before[2] is attempt
            and before[3] == heard
        ):
            return described
        described = _describe_printer(section, books, said, attempt, self._rooms)
        self._printers[section.name] = (section, entry, attempt, heard), described
        return described

    def waiting(self, books: Books) -> tuple[WaitingPlate, ...]:
        """Describe the plates of printing jobs that wait, in the order in which they choose."""
        printing = [job for job in books.jobs.values() if job.state is JobState.PRINTING]
        printing.sort(key=lambda job: (-job.options.priority, job.id))
        known = {job.id: self._plates(books, job) for job in printing}
        self._jobs = {number: self._jobs[number] for number in known}
        return tuple(chain.from_iterable(plates.waiting for plates in known.values()))

    def may_hold_back(self, books: Books, job: Job) -> bool:
        """Tell whether a printing job itself has something for which a plate is offered to no printer."""
        return self._plates(books, job).may_hold_back

    def _plates(self, books: Books, job: Job) -> _JobPlates:
        revision = books.revision(job.id)
        before, described = self._jobs.get(job.id, (None, None))
        if described is None or before is not revision:
            states = ((plate, books.plate_state(plate)) for plate in books.plates_of(job))
            waiting = describe_plates((p for p, state in states if state is PlateState.WAITING), books)
            described = _JobPlates(
                tuple(sorted(waiting, key=lambda plate: plate.priority_key)), may_hold_back(books, job)
            )
            self._jobs[job.id] = revision, described
        return described


@dataclass(frozen=True, slots=True)
class _JobPlates:
    """The plates of a job that wait, and whether something of the job may hold them back."""

    waiting: tuple[WaitingPlate, ...]
    may_hold_back: bool


def availability(snapshot: AgentSnapshot) -> tuple[object, ...]:
    """Return what the scheduler reads of a snapshot; the rest is for people, or reaches the books."""
    reason = snapshot.reason if snapshot.link is Link.FAULT else None
    return snapshot.link, reason, snapshot.reset_verified


def describe_plates(plates: Iterable[Plate], books: Books) -> Iterator[WaitingPlate]:
    """Describe plates of planned jobs."""
    printing = Counter(attempt.job for attempt in books.open_prints())
    for plate in plates:
        job = books.job(plate.job)
        wanted = job.options.printers
        yield WaitingPlate(
            id=plate.id,
            job=plate.job,
            requirements=Requirements(
                material=plate.material,
                colour=job.options.colour,
                nozzle_mm=plate.nozzle_mm,
                kin=plate.kin,
                box=(*plate.min_mm[:2], *plate.max_mm),
            ),
            planned=plate.printer,
            expected_s=plate.expected_s,
            priority=job.options.priority,
            grams=plate.grams,
            heating_s=plate.prelude_s,
            time_factor=plate.time_factor,
            first_layer_s=plate.first_layer_s,
            failed_on=frozenset(p.printer for p in books.prints_of(plate) if p.state is PrintState.FAILED),
            places=None if wanted is None else max(0, wanted - printing[job.id]),
            not_before_s=job.not_before_s,
        )


def may_start_now(attempt: Print, books: Books, situation: Situation) -> bool:
    """Tell whether hours let a print begin of which its agent has not heard yet.

    An agent may have been away since: a start that was right in the evening may be wrong at night.
    """
    printer = situation.fleet.get(attempt.printer)
    (plate,) = describe_plates([books.plates[attempt.plate]], books)
    if printer is None:
        return False
    start = situation.rules.find_start(plate, printer, situation.now_s)
    return start.at_s is not None and start.at_s <= situation.now_s


@dataclass(frozen=True, slots=True)
class PrintLimits:
    """Hours of a print, in seconds since the epoch; None where hours do not decide it.

    Attributes
    ----------
    not_after_s
        Until when it may begin.
    ends_by_s
        When it has to be ended.
    """

    not_after_s: float | None
    ends_by_s: float | None


def find_print_limits(attempt: Print, books: Books, situation: Situation) -> PrintLimits:
    """Find until when a print that may begin now may, and when it has to be ended."""
    printer = situation.fleet.get(attempt.printer)
    if printer is None:
        return PrintLimits(None, None)
    rules, now_s = situation.rules, situation.now_s
    (plate,) = describe_plates([books.plates[attempt.plate]], books)
    latest_s = rules.latest_start_s(plate, printer, now_s)
    return PrintLimits(None if math.isinf(latest_s) else latest_s, rules.ends_by_s(printer, now_s))


def job_requirements(job: Job) -> Requirements:
    """Return what a job asks of a printer before it is planned."""
    own = job.own_gcode
    return Requirements(
        material=job.options.material,
        colour=job.options.colour,
        nozzle_mm=own.nozzle_mm if own else None,
        box=(*own.min_mm[:2], *own.max_mm) if own else None,
    )
