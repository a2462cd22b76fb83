"""Rules for events about a plate. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from farm.model import JobState, Verdict
from farm.state import events as ev
from farm.state.books import Books, put, replace_fields
from farm.state.consequences import Result, add_print, cancel_plate, update_job_state
from farm.state.lifecycles import JOB_LIFECYCLE, InvalidTransition
from farm.state.plate_state import find_successful_print
from farm.state.transitions.rules import change


@change.register
def _(event: ev.PlateAssigned, books: Books) -> Result:
    return add_print(books, event), (ev.SendStart(print_id=event.print_id, printer=event.printer),)


@change.register
def _(event: ev.PlateReplaced, books: Books) -> Result:
    plate = books.plates[event.plate]
    job = books.get_job(plate.job)
    if job.state is not JobState.PRINTING:
        raise InvalidTransition(event, JOB_LIFECYCLE, job.id, job.state)
    kept_fields = {"prints": plate.prints, "counted_from": plate.counted_from, "paused": plate.paused}
    new_plates = [replace_fields(new_plate, **kept_fields) for new_plate in event.plates]
    names = tuple(new_plate.id for new_plate in new_plates)
    old_plate = replace_fields(plate, replaced_by=names)
    job = replace_fields(
        job,
        plates=_replace_names(job.plates, (plate.id,), names),
        parts=_replace_names(job.parts, plate.parts, tuple(part.id for part in event.parts)),
        picture=event.picture or job.picture,
        assembly=event.assembly or job.assembly,
        cuts=_add_file(job.cuts, plate.parts[0], event.decomposition),
        cut_instructions=_add_file(job.cut_instructions, plate.parts[0], event.instructions),
    )
    return put(books, old_plate, job, *new_plates, *event.parts), (ev.LinkFiles(job=job.id),)


def _add_file(files: Mapping[str, str], part: str, file: str | None) -> Mapping[str, str]:
    return files if file is None else {**files, part: file}


def _replace_names(
    names: tuple[str, ...], old_names: tuple[str, ...], new_names: tuple[str, ...]
) -> tuple[str, ...]:
    """Replace the old names in a sequence by the new ones, at the position of the first old name."""
    index = names.index(old_names[0])
    other_names = tuple(name for name in names if name not in old_names)
    return (*other_names[:index], *new_names, *other_names[index:])


@change.register
def _(event: ev.PlatePaused, books: Books) -> Result:
    return put(books, replace_fields(books.plates[event.plate], paused=event.wanted)), ()


@change.register
def _(event: ev.PlateCancelled, books: Books) -> Result:
    plate = books.plates[event.plate]
    books, instructions = cancel_plate(books, plate, f"cancelled by {event.by}")
    return update_job_state(books, plate.job, event.at_s), instructions


@change.register
def _(event: ev.ReprintRequested, books: Books) -> Result:
    plate = books.plates[event.plate]
    job = books.get_job(plate.job)
    if job.pruned_s is not None:
        raise InvalidTransition(event, JOB_LIFECYCLE, job.id, job.state, "pruned: its files were deleted")
    successful_print = find_successful_print(books.list_prints(plate))
    if successful_print is not None:
        books = put(books, replace_fields(successful_print, verdict=Verdict.BAD, verdict_why=event.why))
    books = put(books, replace_fields(plate, cancelled=False, paused=False, counted_from=len(plate.prints)))
    return update_job_state(books, plate.job, event.at_s, reopen=True), ()
