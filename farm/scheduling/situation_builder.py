"""Descriptions of printers and plates for the scheduler, from fleet, books and the agents' latest snapshots.

Pure except for the cache of `SituationBuilder`: unchanged printers and jobs are not described again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from drivers.printers import PROFILES
from farm.config import Fleet, PrinterSection
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    Job,
    JobOptions,
    JobState,
    Link,
    Plate,
    Print,
    Printer,
    PrintState,
    TimeFactors,
)
from farm.scheduling.holds import may_hold_back
from farm.scheduling.matching import Box, Capabilities, FleetPrinter, Requirements, WaitingPlate
from farm.scheduling.plate_queue import JobPlates, PlateQueue
from farm.scheduling.situation import Situation
from farm.scheduling.start_rules import StartRules
from farm.state import Books, PlateState

BuildVolumeFinder = Callable[[PrinterSection], tuple[Box, ...]]


def _describe_printer(
    section: PrinterSection,
    books: Books,
    snapshot: AgentSnapshot | None,
    open_print: Print | None,
    find_build_volumes: BuildVolumeFinder,
) -> FleetPrinter:
    entry = books.get_printer(section.name)
    attention_reason, time_factors = entry.attention_reason, entry.time_factors
    if snapshot is not None and snapshot.link is Link.FAULT and attention_reason is None:
        attention_reason = snapshot.reason or "its agent reports a fault"
    attended_reason = _find_attended_reason(section, snapshot)
    return FleetPrinter(
        name=section.name,
        capabilities=describe_capabilities(section, find_build_volumes),
        bed=entry.bed,
        filament=entry.filament,
        link=snapshot.link if snapshot is not None else Link.STARTING,
        is_booked=open_print is not None,
        attention_reason=attention_reason,
        maintenance=entry.maintenance,
        is_heating=open_print is not None and open_print.state in (PrintState.ASSIGNED, PrintState.HEATING),
        print_end_s=None if open_print is None else _compute_expected_end_s(books, open_print, time_factors),
        job=None if open_print is None else open_print.job,
        heating_end_s=None
        if open_print is None
        else _find_start_s(open_print) + books.plates[open_print.plate].overhead_s,
        grams=_compute_free_grams(books, entry, open_print),
        is_reel_uncertain=entry.reel is not None and entry.reel.uncertain,
        time_factors=time_factors,
        may_print_unattended=not attended_reason,
        attended_reason=attended_reason,
    )


def describe_capabilities(section: PrinterSection, find_build_volumes: BuildVolumeFinder) -> Capabilities:
    """Describe the capabilities of a printer, which do not depend on its state."""
    return Capabilities(
        build_boxes=find_build_volumes(section),
        material=section.material,
        colour=section.colour,
        nozzle_mm=section.nozzle_mm,
        family=PROFILES[section.model].family,
        material_kind=section.material_kind,
    )


def _find_attended_reason(section: PrinterSection, snapshot: AgentSnapshot | None) -> str:
    """Return the reason why a printer prints only in attended hours; empty if it may print unattended."""
    firmware = PROFILES[section.model].firmware
    if snapshot is not None and not snapshot.reset_verified:
        return "a reset of its board has not been verified"
    if not (section.is_simulated or firmware.is_dead_man_observed):
        return f"it is not verified that {firmware.title} switches the heaters off when its host dies"
    return "" if section.unattended else "`unattended: false` in fleet.yaml"


def _compute_free_grams(books: Books, entry: Printer, open_print: Print | None) -> float | None:
    """Return the grams on a printer's reel, minus those of its open print; None if unknown."""
    if entry.reel is None or entry.reel.grams is None or open_print is None:
        return None if entry.reel is None else entry.reel.grams
    return max(0.0, entry.reel.grams - books.plates[open_print.plate].grams)


def _find_start_s(open_print: Print) -> float:
    return open_print.started_s if open_print.started_s is not None else open_print.assigned_s


def _compute_expected_end_s(books: Books, open_print: Print, time_factors: TimeFactors) -> float:
    """Return the expected end of a print, rounded up to whole minutes."""
    expected_s = books.plates[open_print.plate].compute_expected_s(time_factors)
    return math.ceil((_find_start_s(open_print) + expected_s) / 60) * 60.0


def estimate_remaining_s(
    open_print: Print, plate: Plate, report: AgentPrint | None, time_factors: TimeFactors, now_s: float
) -> float:
    """Estimate the remaining time of an open print, in seconds.

    While the print heats, the estimate is based on the expected time; later, on the progress in its G-code.

    Parameters
    ----------
    open_print
        The print.
    plate
        Its plate.
    report
        Report of the printer's agent on this print; None if there is none.
    time_factors
        Time factors of the printer.
    now_s
        Farm time, seconds since the epoch.
    """
    if report is not None and report.progress_s > 0:
        factor = time_factors.compute_factor(plate.feature_shares)
        return max(0.0, plate.sliced_s - report.progress_s) * factor
    return max(0.0, plate.compute_expected_s(time_factors) - (now_s - (open_print.started_s or now_s)))


def update_print_ends(
    situation: Situation, books: Books, snapshots: Mapping[str, AgentSnapshot]
) -> Situation:
    """Return a situation for display, with ends of running prints that are estimated from their progress.

    Decisions use the planned ends instead, because they are made after each event, not after each snapshot.

    Parameters
    ----------
    situation
        The situation, with planned ends.
    books
        The open prints and their plates.
    snapshots
        Latest snapshot of each agent, by printer.
    """

    def update_printer(printer: FleetPrinter) -> FleetPrinter:
        open_print, snapshot = books.find_open_print(printer.name), snapshots.get(printer.name)
        if open_print is None:
            return printer
        report = None if snapshot is None else snapshot.find_print(open_print.id)
        plate, factors = books.plates[open_print.plate], printer.time_factors
        remaining_s = estimate_remaining_s(open_print, plate, report, factors, situation.now_s)
        return replace(printer, print_end_s=situation.now_s + remaining_s)

    return situation.with_printers(tuple([update_printer(printer) for printer in situation.printers]))


class SituationBuilder:
    """Builder of the descriptions of printers and waiting plates, with a cache of unchanged ones.

    Parameters
    ----------
    find_build_volumes
        Function that returns the boxes in which a printer can print.
    """

    def __init__(self, find_build_volumes: BuildVolumeFinder) -> None:
        self._find_build_volumes = find_build_volumes
        self._printers: dict[str, _CachedPrinter] = {}
        self._fleet: Fleet | None = None
        self._sections: dict[str, PrinterSection] = {}  # enabled printers of that fleet, by name
        self._jobs: dict[int, tuple[object, _JobDescription]] = {}
        # `Books.jobs`, and the printers that open jobs of it request by name.
        self._named_printers: tuple[object, frozenset[str]] = (None, frozenset())

    def describe_printers(
        self, fleet: Fleet, books: Books, snapshots: Mapping[str, AgentSnapshot]
    ) -> tuple[FleetPrinter, ...]:
        """Describe the enabled printers."""
        sections, named_printers = self._list_enabled_sections(fleet), self._find_named_printers(books)
        return tuple(
            [
                self._describe_with_cache(section, books, snapshots.get(name), name in named_printers)
                for name, section in sections.items()
            ]
        )

    def describe_printer(
        self, fleet: Fleet, name: str, books: Books, snapshots: Mapping[str, AgentSnapshot]
    ) -> FleetPrinter | None:
        """Describe one printer; None if it is disabled or unknown."""
        section = self._list_enabled_sections(fleet).get(name)
        if section is None:
            return None
        return self._describe_with_cache(
            section, books, snapshots.get(name), name in self._find_named_printers(books)
        )

    def _list_enabled_sections(self, fleet: Fleet) -> dict[str, PrinterSection]:
        if fleet is not self._fleet:
            self._fleet = fleet
            self._sections = {section.name: section for section in fleet.printers if section.enabled}
        return self._sections

    def _describe_with_cache(
        self,
        section: PrinterSection,
        books: Books,
        snapshot: AgentSnapshot | None,
        is_requested_by_name: bool,
    ) -> FleetPrinter:
        entry, open_print = books.get_printer(section.name), books.find_open_print(section.name)
        cached = self._printers.get(section.name)
        if (
            cached is not None
            and cached.section is section
            and cached.entry is entry
            and cached.open_print is open_print
            and cached.is_requested_by_name is is_requested_by_name
            and (cached.snapshot is snapshot or _are_alike(cached.snapshot, snapshot))
        ):
            cached.snapshot = snapshot
            return cached.description
        description = _describe_printer(section, books, snapshot, open_print, self._find_build_volumes)
        if is_requested_by_name:
            description = replace(
                description, capabilities=replace(description.capabilities, requested_name=section.name)
            )
        self._printers[section.name] = _CachedPrinter(
            section, entry, open_print, snapshot, is_requested_by_name, description
        )
        return description

    def _find_named_printers(self, books: Books) -> frozenset[str]:
        """Return the printers that open jobs request by name."""
        if self._named_printers[0] is not books.jobs:
            open_jobs = (job for job in books.jobs.values() if not job.state.ended)
            names = frozenset(name for job in open_jobs for name in job.options.only)
            self._named_printers = books.jobs, names
        return self._named_printers[1]

    def describe_waiting_plates(self, books: Books) -> PlateQueue:
        """Describe the waiting plates of printing jobs."""
        printing_jobs = [job for job in books.jobs.values() if job.state is JobState.PRINTING]
        queue = self.describe_job_plates(books, printing_jobs)
        self._jobs = {job.id: self._jobs[job.id] for job in printing_jobs}
        return queue

    def describe_job_plates(self, books: Books, jobs: Iterable[Job]) -> PlateQueue:
        """Describe the waiting plates of some printing jobs."""
        return PlateQueue.from_jobs(self._describe_job(books, job).waiting_plates for job in jobs)

    def may_hold_back(self, books: Books, job: Job) -> bool:
        """Return whether a plate of a printing job may be held back by the job's own state."""
        return self._describe_job(books, job).may_hold_back

    def _describe_job(self, books: Books, job: Job) -> _JobDescription:
        version = books.find_job_version(job.id)
        cached_version, description = self._jobs.get(job.id, (None, None))
        if description is None or cached_version is not version:
            states = ((plate, books.find_plate_state(plate)) for plate in books.list_plates(job))
            waiting = describe_plates((p for p, state in states if state is PlateState.WAITING), books)
            description = _JobDescription(JobPlates.from_plates(waiting), may_hold_back(books, job))
            self._jobs[job.id] = version, description
        return description


@dataclass(slots=True)
class _CachedPrinter:
    """Description of a printer, with its inputs; `snapshot` is the latest one that led to it."""

    section: PrinterSection
    entry: Printer
    open_print: Print | None
    snapshot: AgentSnapshot | None
    is_requested_by_name: bool
    description: FleetPrinter


@dataclass(frozen=True, slots=True)
class _JobDescription:
    """Waiting plates of a job, and whether the job's state may hold back one of them."""

    waiting_plates: JobPlates
    may_hold_back: bool


def _are_alike(first: AgentSnapshot | None, second: AgentSnapshot | None) -> bool:
    """Return whether two snapshots of a printer are equal in the fields that the scheduler reads."""
    if first is None or second is None:
        return first is second
    return select_scheduling_fields(first) == select_scheduling_fields(second)


def select_scheduling_fields(snapshot: AgentSnapshot) -> tuple[object, ...]:
    """Return the fields of a snapshot that the scheduler reads."""
    reason = snapshot.reason if snapshot.link is Link.FAULT else None
    return snapshot.link, reason, snapshot.reset_verified


def describe_plates(plates: Iterable[Plate], books: Books) -> Iterator[WaitingPlate]:
    """Yield the description of each of these plates, which belong to planned jobs."""
    for plate in plates:
        job = books.get_job(plate.job)
        printers = job.options.printers
        yield WaitingPlate(
            id=plate.id,
            name=plate.name,
            job=plate.job,
            requirements=derive_plate_requirements(plate, job.options),
            planned_printer=plate.printer,
            expected_s=plate.expected_s,
            priority=job.priority,
            rank=job.moved_rank,
            grams=plate.grams,
            overhead_s=plate.overhead_s,
            time_factor=plate.time_factor,
            feature_shares=plate.feature_shares,
            first_layer_s=plate.first_layer_s,
            failed_on=frozenset(p.printer for p in books.list_prints(plate) if p.state is PrintState.FAILED),
            extra_printer_count=None
            if printers is None
            else max(0, printers - sum(1 for _ in books.list_open_prints(job.id))),
            is_reprint=bool(plate.prints),
            not_before_s=job.not_before_s,
            glue_rank=min(_find_glue_ranks(plate, books), default=0),
        )


def _find_glue_ranks(plate: Plate, books: Books) -> list[int]:
    """Find the positions of a plate's parts in the order of gluing; parts without one are omitted."""
    parts = (books.parts.get(name) for name in plate.parts)
    return [part.glue_rank for part in parts if part is not None and part.glue_rank is not None]


def derive_plate_requirements(plate: Plate, options: JobOptions | None = None) -> Requirements:
    """Return the requirements of a plate, with the colour and the printers that its job requests."""
    return Requirements(
        material=plate.material,
        colour=options.colour if options else None,
        nozzle_mm=plate.nozzle_mm,
        family=plate.family,
        allowed_printers=options.only if options else (),
        box=(*plate.min_mm[:2], *plate.max_mm),
    )


def count_spares(books: Books) -> dict[int, int]:
    """Return the number of printers that each printing job keeps for failed plates."""
    jobs = (job for job in books.jobs.values() if job.state is JobState.PRINTING)
    return {job.id: job.options.spares for job in jobs if job.options.spares}


def may_start_now(
    open_print: Print, books: Books, printer: FleetPrinter, rules: StartRules, now_s: float
) -> bool:
    """Return whether a print that its agent has not confirmed yet may still start now, by the hours.

    The agent may have been unreachable for hours, and the attended hours may have ended meanwhile.
    """
    (plate,) = describe_plates([books.plates[open_print.plate]], books)
    start = rules.find_start(plate, printer, now_s)
    return start.at_s is not None and start.at_s <= now_s


@dataclass(frozen=True, slots=True)
class PrintLimits:
    """Limits that attended and quiet hours set on a print, in seconds since the epoch; None for no limit."""

    latest_start_s: float | None
    latest_end_s: float | None


def find_print_limits(
    open_print: Print, books: Books, printer: FleetPrinter, rules: StartRules, now_s: float
) -> PrintLimits:
    """Find the latest start, and the latest end, of a print that may start now."""
    (plate,) = describe_plates([books.plates[open_print.plate]], books)
    latest_s = rules.find_latest_start_s(plate, printer, now_s)
    return PrintLimits(None if math.isinf(latest_s) else latest_s, rules.find_latest_end_s(printer, now_s))


def derive_job_requirements(job: Job) -> Requirements:
    """Return the requirements of a job that is not planned yet."""
    own_gcode = job.own_gcode
    return Requirements(
        material=job.options.material,
        colour=job.options.colour,
        nozzle_mm=own_gcode.nozzle_mm if own_gcode else None,
        allowed_printers=job.options.only,
        box=(*own_gcode.min_mm[:2], *own_gcode.max_mm) if own_gcode else None,
    )
