"""Builder of situations from fleet, books and the agents' latest snapshots. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass

from drivers.printers import PROFILES
from farm.config import PrinterSection
from farm.model import AgentSnapshot, Job, JobState, Link, Plate, Print, PrintState
from farm.scheduling.matching import Box, Capabilities, FleetPrinter, Requirements, WaitingPlate
from farm.scheduling.situation import Situation
from farm.scheduling.start_rules import StartRules
from farm.state import Books

BuildVolumes = Callable[[PrinterSection], tuple[Box, ...]]


def describe_printers(
    printers: Iterable[PrinterSection],
    books: Books,
    snapshots: Mapping[str, AgentSnapshot],
    rooms: BuildVolumes,
) -> list[FleetPrinter]:
    """Describe the enabled printers."""
    attempts = {attempt.printer: attempt for attempt in books.open_prints()}
    return [
        _describe_printer(section, books, snapshots.get(section.name), attempts.get(section.name), rooms)
        for section in printers
        if section.enabled
    ]


def _describe_printer(
    section: PrinterSection,
    books: Books,
    report: AgentSnapshot | None,
    attempt: Print | None,
    rooms: BuildVolumes,
) -> FleetPrinter:
    entry = books.printer(section.name)
    attention_reason = entry.attention_reason
    if report is not None and report.link is Link.FAULT and attention_reason is None:
        attention_reason = report.reason or "its agent reports a fault"
    verified = report is None or report.reset_verified
    return FleetPrinter(
        name=section.name,
        capabilities=Capabilities(
            rooms(section), section.material, section.colour, section.nozzle_mm, PROFILES[section.model].kin
        ),
        bed=entry.bed,
        filament=entry.filament,
        link=report.link if report is not None else Link.STARTING,
        booked=attempt is not None,
        attention_reason=attention_reason,
        maintenance=entry.maintenance,
        heating=attempt is not None and attempt.state in (PrintState.ASSIGNED, PrintState.HEATING),
        free_s=None if attempt is None else _expected_end_s(books, attempt, entry.time_factor),
        grams=entry.reel.grams if entry.reel is not None else None,
        reel_uncertain=entry.reel is not None and entry.reel.uncertain,
        time_factor=entry.time_factor,
        unattended=section.unattended and verified,
        why_attended="fleet.yaml says so" if verified else "its board was not seen to reset",
    )


def _expected_end_s(books: Books, attempt: Print, factor: float) -> float:
    """Return the expected end of a print, rounded up to whole minutes."""
    begun_s = attempt.started_s if attempt.started_s is not None else attempt.assigned_s
    return math.ceil((begun_s + books.plates[attempt.plate].expected_on(factor)) / 60) * 60.0


def describe_plates(plates: Iterable[Plate], books: Books) -> Iterator[WaitingPlate]:
    """Describe plates of planned jobs."""
    printing: dict[int, int] = {}
    for attempt in books.open_prints():
        printing[attempt.job] = printing.get(attempt.job, 0) + 1
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
            places=None if wanted is None else max(0, wanted - printing.get(job.id, 0)),
            not_before_s=job.not_before_s,
        )


def build_situation(
    books: Books,
    held_back: Container[str],
    printers: Iterable[FleetPrinter],
    rules: StartRules,
    now_s: float,
    time_scale: float,
) -> Situation:
    """Build the situation at one moment.

    Parameters
    ----------
    books
        As committed.
    held_back
        Ids of waiting plates that are offered to no printer.
    printers
        The fleet, as `describe_printers` describes it.
    rules
        Hours and the heating limit.
    now_s
        Farm time, seconds since the epoch.
    time_scale
        Farm seconds in a wall second.
    """
    waiting = (plate for plate in books.waiting_plates() if plate.id not in held_back)
    printing = (job for job in books.jobs.values() if job.state is JobState.PRINTING)
    attended = rules.is_attended(now_s)  # a person can clear a bed then: no printer is kept free
    return Situation(
        waiting=tuple(describe_plates(waiting, books)),
        printers=tuple(printers),
        rules=rules,
        now_s=now_s,
        time_scale=time_scale,
        spares=0 if attended else max((job.options.spares for job in printing), default=0),
    )


def may_start_now(attempt: Print, books: Books, situation: Situation) -> bool:
    """Return whether hours allow a start that its agent has not confirmed yet.

    The agent may have been away since: a start that was allowed in the evening may not be at night.
    """
    printer = situation.fleet.get(attempt.printer)
    (plate,) = describe_plates([books.plates[attempt.plate]], books)
    if printer is None:
        return False
    start = situation.rules.find_start(plate, printer, situation.now_s)
    return start.at_s is not None and start.at_s <= situation.now_s


@dataclass(frozen=True, slots=True)
class PrintLimits:
    """Limits that hours set to a print, in seconds since the epoch; None where they set none.

    Attributes
    ----------
    not_after_s
        Latest start.
    ends_by_s
        Latest end.
    """

    not_after_s: float | None
    ends_by_s: float | None


def find_print_limits(attempt: Print, books: Books, situation: Situation) -> PrintLimits:
    """Find the latest start and end of a print that may begin now."""
    printer = situation.fleet.get(attempt.printer)
    if printer is None:
        return PrintLimits(None, None)
    rules, now_s = situation.rules, situation.now_s
    (plate,) = describe_plates([books.plates[attempt.plate]], books)
    latest_s = rules.latest_start_s(plate, printer, now_s)
    return PrintLimits(None if math.isinf(latest_s) else latest_s, rules.ends_by_s(printer, now_s))


def job_requirements(job: Job) -> Requirements:
    """Return the requirements of a job that is not planned yet."""
    own = job.own_gcode
    return Requirements(
        material=job.options.material,
        colour=job.options.colour,
        nozzle_mm=own.nozzle_mm if own else None,
        box=(*own.min_mm[:2], *own.max_mm) if own else None,
    )
