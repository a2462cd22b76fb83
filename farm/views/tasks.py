"""Tasks for people: the to-do list of `farm status`. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import datetime, tzinfo

from farm import api
from farm.config import PrinterSection
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    Bed,
    Hold,
    JobState,
    Link,
    Outage,
    Part,
    PlanStep,
    Print,
    Printer,
    PrintState,
    TextTime,
)
from farm.state import Books, PlateState, find_part_id, find_possibly_complete_print, find_stopped_print
from farm.text import format_count, format_mass, format_recent_moment
from farm.views.context import ViewContext
from farm.views.host_losses import describe_lost_hosts, list_lost_printers
from farm.wording import make_text_time

_RANKS = {
    "alarm": 0,
    "farm": 1,
    "outage": 2,
    "host": 2,
    "replace": 2,
    "look": 2,  # inspect a printer
    "connect": 3,
    "resume": 4,
    "hours": 4,
    "clear": 5,
}
"""Rank of a task by its code, 0 for the most urgent; tasks of equal rank keep the order of the fleet."""

_MAX_NAMED_PARTS = 8
"""Maximum number of beds to clear for which `brief` names the parts."""


def list_tasks(context: ViewContext) -> list[api.Todo]:
    """List the tasks for people, most urgent first."""
    outage = context.books.outage
    lost_printers = () if outage is None else outage.printers
    tasks = list(_list_farm_tasks(context))
    if outage is not None:
        tasks.append(_describe_outage(context, outage))
    tasks += _list_host_tasks(context)
    occupied_printers = []
    for section in context.fleet.printers:
        printer_tasks = list(_list_printer_tasks(context, section, section.name in lost_printers))
        tasks += printer_tasks
        if not printer_tasks and _needs_clearing(context, section.name) and section.name not in lost_printers:
            occupied_printers.append(section.name)
    if occupied_printers:
        occupied_printers, labels = _sort_by_gluing_order(context, occupied_printers)
        beds = format_count(len(occupied_printers), "bed")
        text = f"clear {beds}: {' '.join(labels)}, then `farm cleared PRINTER`"
        has_parts = labels != occupied_printers and len(labels) <= _MAX_NAMED_PARTS
        brief = " ".join(labels) if has_parts else ""
        tasks.append(api.Todo(code="clear", printers=occupied_printers, text=text, brief=brief))
    return [
        *sorted(tasks, key=lambda task: _RANKS[task.code]),
        *list_request_tasks(context.books, context.plate_holds),
    ]


def _list_farm_tasks(context: ViewContext) -> Iterator[api.Todo]:
    """Yield the tasks to solve problems of the farm as a whole."""
    for text in context.warnings:
        yield api.Todo(code="farm", printers=[], text=text)
    for number, progress in context.progress.items():
        if progress.step is PlanStep.NO_ROOM:
            text = f"free some space on the disk of {context.state.root}: job {number} waits for it"
            yield api.Todo(code="farm", printers=[], text=text, jobs=[number])


def _list_host_tasks(context: ViewContext) -> Iterator[api.Todo]:
    """Yield one task for all hosts that do not answer."""
    printers = list_lost_printers(context.fleet, context.books)
    losses = [printer.host_loss for printer in printers if printer.host_loss is not None]
    if losses:
        text = f"{describe_lost_hosts(losses)} (`farm hosts`)"
        yield api.Todo(code="host", printers=[printer.name for printer in printers], text=text)


def _describe_outage(context: ViewContext, outage: Outage) -> api.Todo:
    text = (
        f"{' '.join(outage.printers)} were lost at the same time (power, USB hub or host?): inspect them, "
        "then `farm resume`"
    )
    text += "".join(_format_good_command(context, name) for name in outage.printers)
    good = {name: part for name in outage.printers if (part := _find_possibly_good_part(context, name))}
    return api.Todo(code="outage", printers=list(outage.printers), text=text, good=good)


def _list_printer_tasks(context: ViewContext, section: PrinterSection, is_lost: bool) -> Iterator[api.Todo]:
    """Yield the tasks at a printer, except clearing its bed: a separate task lists all beds to clear.

    Parameters
    ----------
    context, section
        Current data of the farm, and the printer's section of `fleet.yaml`.
    is_lost
        True if the printer is part of an outage, which has one task for all its printers.
    """
    name = section.name
    entry, snapshot = context.books.get_printer(name), context.find_snapshot(name)
    attempt = context.books.find_open_print(name)
    if snapshot.alarm is not None:
        state = attempt.state if attempt is not None else snapshot.link
        text = f"go to {name} now: {snapshot.alarm} ({state}{_format_temperatures(snapshot)})"
        yield api.Todo(code="alarm", printers=[name], text=text)
        return
    if is_lost or snapshot.host_lost or (entry.maintenance is not None and attempt is None):
        return
    attention = entry.attention_reason
    reason = attention or (snapshot.reason if snapshot.link is Link.FAULT else None)
    if section.enabled and _is_absent(context, snapshot):
        extra_text = f"; and inspect it: {attention}" if attention else ""
        if entry.unreported_since_s is not None:
            extra_text += "; its prints since the backup of the database are unknown"
        problem = f"{name}: {snapshot.reason or 'no answer'}"
        yield api.Todo(code="connect", printers=[name], text=f"connect {problem}{extra_text}", brief=problem)
    elif snapshot.outdated and attention is None:
        problem = f"{name} {snapshot.reason}"
        yield api.Todo(code="replace", printers=[name], text=problem, brief=problem)
    elif reason:
        yield _describe_inspection(context, entry, reason)
    elif attempt is not None:
        remaining_s, zone = context.estimate_remaining_s(attempt), context.fleet.zone
        yield from list_deadline_tasks(
            attempt, context.find_reported_print(attempt), remaining_s, context.now_s, zone
        )


def _describe_inspection(context: ViewContext, printer: Printer, reason: str) -> api.Todo:
    """Describe the task to inspect a printer, with the time since which the inspection is due."""
    name, good_command = printer.name, _format_good_command(context, printer.name)
    since_text, times = "", list[TextTime]()
    if printer.attention_reason is not None and printer.attention_since_s is not None:
        moment, now = (
            datetime.fromtimestamp(moment_s, context.fleet.zone)
            for moment_s in (printer.attention_since_s, context.now_s)
        )
        since = TextTime(text=format_recent_moment(moment, now), at=moment.isoformat("T", "seconds"))
        since_text, times = f" ({since.text})", [since]
    text = f"inspect {name}: {reason}; then `farm cleared {name}`{good_command}"
    good_part = _find_possibly_good_part(context, name)
    brief = f"{name}: {reason}{since_text}{good_command}"
    good = {} if good_part is None else {name: good_part}
    return api.Todo(code="look", printers=[name], text=text, brief=brief, good=good, times=times)


def _is_absent(context: ViewContext, snapshot: AgentSnapshot) -> bool:
    is_connecting = snapshot.link in (Link.STARTING, Link.CONNECTING)
    return snapshot.link is Link.ABSENT or (is_connecting and context.is_startup_over)


def _needs_clearing(context: ViewContext, printer: str) -> bool:
    entry = context.books.get_printer(printer)
    is_available = context.books.find_open_print(printer) is None and entry.maintenance is None
    return is_available and entry.bed is not Bed.CLEAR


def _find_possibly_good_part(context: ViewContext, printer: str) -> str | None:
    """Return the name of the part that a failed print left on a bed, if it may be good; else None."""
    attempt = find_possibly_complete_print(context.books, printer)
    return None if attempt is None else find_part_id(context.books, attempt)


def _sort_by_gluing_order(context: ViewContext, printers: list[str]) -> tuple[list[str], list[str]]:
    """Return printers, sorted by the gluing order of the parts on their beds, and a label for each.

    A label is the name of the printer, with its part if the gluing order of the part is known.
    """
    part_by_printer = {name: _find_part_on_bed(context.books, name) for name in printers}
    unknown_rank = (math.inf, 0, 0)

    def find_rank(name: str) -> tuple[float, int, int]:
        part = part_by_printer[name]
        return unknown_rank if part is None else (part.job, part.copy_number, part.glue_rank or 0)

    order = sorted(printers, key=find_rank)
    parts = {name: part for name in order if (part := part_by_printer[name]) is not None and part.glue_rank}
    return order, [f"{name} ({parts[name].id})" if name in parts else name for name in order]


def _find_part_on_bed(books: Books, printer: str) -> Part | None:
    """Find the part that the last print on a printer left on its bed."""
    attempt = books.find_last_print(printer)
    return None if attempt is None else books.parts[books.plates[attempt.plate].parts[0]]


def _format_good_command(context: ViewContext, printer: str) -> str:
    """Format the command that reports a failed print's part as good; empty if the part cannot be good."""
    part = _find_possibly_good_part(context, printer)
    return (
        ""
        if part is None
        else f"; if part {part} is good nevertheless: `farm cleared {printer} --good {part}`"
    )


def _format_temperatures(snapshot: AgentSnapshot) -> str:
    """Format the known temperatures of a printer."""
    heaters = (
        ("nozzle", snapshot.nozzle_c, snapshot.nozzle_target_c),
        ("bed", snapshot.bed_c, snapshot.bed_target_c),
    )
    return "".join(
        f", {name} {now_c:.0f} C, target {target_c or 0.0:.0f}"
        for name, now_c, target_c in heaters
        if now_c is not None
    )


# -- prints that will be stopped early ----------------------------------------------------------------------


def list_deadline_tasks(
    attempt: Print, reported_print: AgentPrint | None, remaining_s: float, now_s: float, zone: tzinfo
) -> list[api.Todo]:
    """List the tasks that keep a print from an early end: resume the print, or extend the attended hours.

    Parameters
    ----------
    attempt, reported_print
        An open print, and its agent's latest report on it.
    remaining_s, now_s
        Remaining printing time, and farm time, in seconds.
    zone
        Time zone of the times in the texts.
    """
    if reported_print is None or attempt.state is PrintState.ENDING:
        return []
    name, deadlines = attempt.printer, []
    hours_end_s = math.inf if reported_print.ends_by_s is None else reported_print.ends_by_s
    # The deadline applies only after the head has parked, and only until a person resumes the print.
    is_waiting = attempt.state is PrintState.PAUSED and attempt.pause_requested
    if is_waiting and reported_print.pause_ends_s is not None:
        deadline = make_text_time(min(reported_print.pause_ends_s, hours_end_s), now_s, zone)
        text = f"resume {name} by {deadline.text}, or its print will be ended: `farm resume {name}`"
        deadlines.append(api.Todo(code="resume", printers=[name], text=text, times=[deadline]))
    end_s = now_s + remaining_s
    if end_s > hours_end_s:
        end, hours_end = times = [make_text_time(at_s, now_s, zone) for at_s in (end_s, hours_end_s)]
        problem = f"{name} would finish at {end.text}, but its print will be stopped at {hours_end.text}"
        text = (
            f"{problem}, when the attended hours end: if somebody stays, extend `attended` in "
            "fleet.yaml and restart the daemon"
        )
        deadlines.append(api.Todo(code="hours", printers=[name], text=text, brief=problem, times=times))
    return deadlines


# -- jobs that wait for a person ----------------------------------------------------------------------------


def list_request_tasks(books: Books, plate_holds: Mapping[str, Hold]) -> list[api.Todo]:
    """List the tasks to approve jobs, decide on stopped parts, and change or weigh reels."""
    return [
        *_list_approval_tasks(books),
        *_list_stopped_part_tasks(books),
        *_list_reel_tasks(books, plate_holds),
    ]


def _list_approval_tasks(books: Books) -> Iterator[api.Todo]:
    held_jobs = [job for job in books.jobs.values() if job.state is JobState.HELD]
    restored_jobs = [job.id for job in held_jobs if job.restored]
    if restored_jobs:
        jobs = f"job{'s' * (len(restored_jobs) > 1)} {' '.join(map(str, restored_jobs))}"
        text = (
            f"the database was restored from a backup: check which parts of {jobs} were printed since, "
            "cancel those with `farm cancel JOB/PART`, then `farm approve JOB`"
        )
        yield api.Todo(code="restored", printers=[], text=text, jobs=restored_jobs)
    for job in held_jobs:
        if not job.options.dry_run:
            grams = sum(plate.grams for plate in books.list_plates(job))
            subject = f"job {job.id} ({format_count(len(job.parts), 'part')}, {format_mass(grams)})"
            text = f"approve {subject}: `farm approve {job.id}`"
            yield api.Todo(code="approve", printers=[], text=text, brief=subject, jobs=[job.id])


def _list_stopped_part_tasks(books: Books) -> Iterator[api.Todo]:
    """Yield a task for each job with parts that `farm estop` stopped, until a person decides on them."""
    parts: dict[int, list[str]] = {}
    paused_plates = (plate for plate in books.plates.values() if plate.paused)
    for plate in paused_plates:
        is_waiting = books.find_plate_state(plate) is PlateState.WAITING
        if not is_waiting or books.jobs[plate.job].state is not JobState.PRINTING:
            continue
        if find_stopped_print(plate, books.list_prints(plate)) is not None:
            parts.setdefault(plate.job, []).extend(plate.parts)
    for job, names in sorted(parts.items()):
        if len(names) == 1:
            subject = f"part {names[0]}"
            choice = (
                f"print it again with `farm resume {names[0]}`, or give it up with `farm cancel {names[0]}`"
            )
        else:
            subject = f"{format_count(len(names), 'part')} of job {job}"
            choice = f"print them again with `farm resume {job}`, or give one up with `farm cancel JOB/PART`"
        text = f"{subject} stopped by `farm estop`: {choice}"
        yield api.Todo(code="stopped", printers=[], text=text, brief=subject, jobs=[job])


def _list_reel_tasks(books: Books, plate_holds: Mapping[str, Hold]) -> Iterator[api.Todo]:
    short_reels: dict[str, str] = {}  # by printer: text about the next plate for which the reel is too short
    for hold in plate_holds.values():
        if hold.reel is not None:
            short_reels.setdefault(hold.reel.printer, hold.reel.text)
    for name, reel in sorted(short_reels.items()):
        text = f"{reel}: load a reel, then `farm load {name}`"
        yield api.Todo(code="reel", printers=[name], text=text, brief=reel)
    uncertain_reels = [
        name for name, printer in books.printers.items() if printer.reel and printer.reel.uncertain
    ]
    if uncertain_reels:
        names = " ".join(uncertain_reels)
        text = f"weigh the reels of {names} (the database was restored), then `farm load PRINTER --grams G`"
        yield api.Todo(code="reel", printers=uncertain_reels, text=text, brief=f"weigh {names}")
