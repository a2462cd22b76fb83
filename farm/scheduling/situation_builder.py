"""What the scheduler is told: fleet, books and the agents' latest words as its views. Data in, data out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from drivers.printers import PROFILES
from farm.config import PrinterSection
from farm.model import AgentSnapshot, Hold, HoldCode, Job, JobState, Link, Plate, Print, PrintState
from farm.scheduling.matching import Box, Capabilities, FleetPrinter, Requirements, WaitingPlate
from farm.scheduling.start_rules import StartRules
from farm.state.books import Books
from farm.state.faults import LOSSES
from farm.state.plate_state import PlateState, stopped_print

Rooms = Callable[[PrinterSection], tuple[Box, ...]]


def describe_printers(
    printers: Iterable[PrinterSection], books: Books, snapshots: Mapping[str, AgentSnapshot], rooms: Rooms
) -> list[FleetPrinter]:
    """The printers that may be used."""
    attempts = {attempt.printer: attempt for attempt in books.open_prints()}
    return [
        _printer_view(section, books, snapshots.get(section.name), attempts.get(section.name), rooms)
        for section in printers
        if section.enabled
    ]


def _printer_view(
    section: PrinterSection, books: Books, said: AgentSnapshot | None, attempt: Print | None, rooms: Rooms
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
        grams=entry.reel.grams if entry.reel is not None else None,
        reel_doubted=entry.reel is not None and entry.reel.doubted,
        time_factor=entry.time_factor,
        unattended=section.unattended and verified,
        why_attended="fleet.yaml says so" if verified else "its board was not seen to reset",
    )


def _expected_end_s(books: Books, attempt: Print, factor: float) -> float:
    """When a print should end, as expected when it began: in whole minutes, so that it is seldom news."""
    begun_s = attempt.started_s if attempt.started_s is not None else attempt.assigned_s
    return math.ceil((begun_s + books.plates[attempt.plate].seconds(factor)) / 60) * 60.0


def describe_plates(plates: Iterable[Plate], books: Books) -> Iterator[WaitingPlate]:
    """Plates of planned jobs."""
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


def may_begin(
    attempt: Print, books: Books, printers: Iterable[FleetPrinter], rules: StartRules, now_s: float
) -> bool:
    """Whether hours let a print begin that its printer was given, and that its agent has not heard of.

    An agent may have been away since: what was right for the evening may be the middle of the night.
    """
    printer = next((p for p in printers if p.name == attempt.printer), None)
    (plate,) = describe_plates([books.plates[attempt.plate]], books)
    if printer is None:
        return False
    start = rules.start(plate, printer, now_s)
    return start.at_s is not None and start.at_s <= now_s


@dataclass(frozen=True, slots=True)
class Span:
    """When hours let a print begin and go on; None where they do not decide it."""

    not_after_s: float | None
    ends_by_s: float | None


def span(
    attempt: Print, books: Books, printers: Iterable[FleetPrinter], rules: StartRules, now_s: float
) -> Span:
    """Until when a print that may begin now may, and when what is printed there has to be ended."""
    printer = next((p for p in printers if p.name == attempt.printer), None)
    if printer is None:
        return Span(None, None)
    (plate,) = describe_plates([books.plates[attempt.plate]], books)
    latest_s = rules.latest_s(plate, printer, now_s)
    return Span(None if math.isinf(latest_s) else latest_s, rules.ends_by_s(printer, now_s))


def job_requirements(job: Job) -> Requirements:
    """What a job asks of a printer before it is planned."""
    own = job.own_gcode
    return Requirements(
        material=job.options.material,
        colour=job.options.colour,
        nozzle_mm=own.nozzle_mm if own else None,
        box=(*own.min_mm[:2], *own.max_mm) if own else None,
    )


def own_holds(books: Books, printers: Iterable[PrinterSection], now_s: float) -> dict[str, Hold]:
    """The plates that are offered to no printer, and why."""
    held = {}
    untold = " ".join(
        section.name for section in printers if section.enabled and _untold(books, section.name)
    )
    for job in books.jobs.values():
        for plate in books.plates_of(job) if job.state is JobState.PRINTING else ():
            hold = _own_hold(books, job, plate, untold if job.restored else "", now_s)
            if hold is not None:
                held[plate.id] = hold
    return held


def _untold(books: Books, printer: str) -> bool:
    """Whether a printer may have printed what the books take for waiting; none that a person has in hand."""
    entry = books.printer(printer)
    return entry.unreported_since_s is not None and entry.maintenance is None


def _own_hold(books: Books, job: Job, plate: Plate, untold: str, now_s: float) -> Hold | None:
    """Why a plate would start on no printer at all; `untold` printers may have printed it."""
    standing = books.plate_state(plate)
    if standing is PlateState.OUT_OF_ATTEMPTS:
        text = f"plate {plate.id} failed too often: `farm reprint {job.id} {plate.parts[0]}`"
        return Hold(code=HoldCode.OUT_OF_ATTEMPTS, text=text)
    if standing is not PlateState.WAITING:
        return None
    if books.outage is not None:
        text = f"{' '.join(books.outage.printers)} were lost at once: look, then `farm resume`"
        return Hold(code=HoldCode.OUTAGE, text=text)
    if untold:
        text = (
            f"{untold} may have printed it since the books were copied: connect them, or `farm maintenance`"
        )
        return Hold(code=HoldCode.UNTOLD, text=text)
    if job.paused:
        return Hold(code=HoldCode.PAUSED, text=f"job {job.id} is paused: `farm resume {job.id}`")
    part = plate.parts[0]
    if (halted := stopped_print(plate, books.prints_of(plate))) is not None:
        text = f"`farm estop` stopped it on {halted.printer}: `farm resume {part}` prints it again"
        return Hold(code=HoldCode.STOPPED, text=text)
    if plate.paused:
        return Hold(code=HoldCode.PAUSED, text=f"part {part} is paused: `farm resume {part}`")
    last = books.prints[plate.prints[-1]] if plate.prints else None
    lost_s = last.ended_s if last is not None and last.fault in LOSSES else None
    if last is not None and lost_s is not None and abs(now_s - lost_s) <= books.outage_window_s:
        text = f"{last.printer} was lost just now: others may be lost with it"
        return Hold(code=HoldCode.JUST_LOST, text=text)
    return None
