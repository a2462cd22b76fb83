"""Validation of the books: consistency rules that always hold. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Iterator

from farm.model import Bed, JobState, Print, PrintState
from farm.state.books import Books
from farm.state.plate_state import MAX_ATTEMPTS, PlateState, derive_job_state, list_counted_failures
from farm.text import format_count

_DERIVED_STATES = (JobState.PRINTING, JobState.PRINTED, JobState.DONE, JobState.FAILED)
"""States of a job that follow from the states of its plates alone."""
_UNPLANNED_STATES = (JobState.QUEUED, JobState.PLANNING)


def validate_books(books: Books) -> list[str]:
    """Check that the books are consistent.

    Parameters
    ----------
    books
        All entities, from a daemon or read from disk.

    Returns
    -------
    list of str
        A sentence for each inconsistency, beginning with the entity; empty if there is none.
    """
    problems = list(_find_dangling_references(books))
    if problems:  # the other checks follow the references
        return problems
    checks = (_check_jobs, _check_plates, _check_prints, _check_printers, _check_outages)
    return [problem for check in checks for problem in check(books)]


def _find_dangling_references(books: Books) -> Iterator[str]:
    for job in books.jobs.values():
        yield from _check_references(f"job {job.id}: its plate", job.plates, books.plates)
        yield from _check_references(f"job {job.id}: its part", job.parts, books.parts)
    for plate in books.plates.values():
        yield from _check_references(f"plate {plate.id}: its job", (plate.job,), books.jobs)
        yield from _check_references(f"plate {plate.id}: its part", plate.parts, books.parts)
        yield from _check_references(f"plate {plate.id}: its print", plate.prints, books.prints)
        yield from _check_references(f"plate {plate.id}: its replacement", plate.replaced_by, books.plates)
    for attempt in books.prints.values():
        yield from _check_references(f"print {attempt.id}: its plate", (attempt.plate,), books.plates)
        yield from _check_references(f"print {attempt.id}: its job", (attempt.job,), books.jobs)
        yield from _check_references(f"print {attempt.id}: its printer", (attempt.printer,), books.printers)


def _check_references(owner: str, names: Iterable[object], entities: Container[object]) -> Iterator[str]:
    yield from (f"{owner} {name} does not exist" for name in names if name not in entities)


def _check_jobs(books: Books) -> Iterator[str]:
    for job in books.jobs.values():
        for plate in books.list_plates(job):
            if plate.job != job.id:
                yield f"job {job.id}: its plate {plate.id} belongs to job {plate.job}"
            if plate.replaced_by:
                yield f"job {job.id}: its plate {plate.id} is replaced by {' '.join(plate.replaced_by)}"
        if job.state in _UNPLANNED_STATES and job.plates:
            yield f"job {job.id}: it is {job.state} and has plates"
        if job.state in _DERIVED_STATES and job.plates:
            derived_state = derive_job_state(
                [books.find_plate_state(plate) for plate in books.list_plates(job)]
            )
            if derived_state is not job.state:
                yield f"job {job.id}: it is {job.state}, but according to its plates it is {derived_state}"
        if job.state.ended and job.ended_s is None:
            yield f"job {job.id}: it is {job.state} and has no end time"


def _check_plates(books: Books) -> Iterator[str]:
    for plate in books.plates.values():
        prints = list(books.list_prints(plate))
        open_prints = [p for p in prints if not p.state.ended and not p.restored]
        if len(open_prints) > 1:
            yield f"plate {plate.id}: it is printed on {' and '.join(p.printer for p in open_prints)} at once"
        if not plate.replaced_by and len(list_counted_failures(plate, prints)) > MAX_ATTEMPTS:
            yield f"plate {plate.id}: it failed more than {MAX_ATTEMPTS} times"
        if plate.counted_from > len(plate.prints):
            yield (
                f"plate {plate.id}: its failures count from index {plate.counted_from}, and it has "
                f"{format_count(len(plate.prints), 'print')}"
            )


def _check_prints(books: Books) -> Iterator[str]:
    for attempt in books.prints.values():
        plate, job = books.plates[attempt.plate], books.jobs[attempt.job]
        if attempt.id not in plate.prints:
            yield f"print {attempt.id}: its plate {plate.id} does not list it"
        if attempt.verdict is not None and attempt.state is not PrintState.DONE:
            yield f"print {attempt.id}: it is {attempt.state} and {attempt.verdict}"
        if attempt.grams < 0.0:
            yield f"print {attempt.id}: it used {attempt.grams:g} g"
        if attempt.state.ended:
            if attempt.ended_s is None:
                yield f"print {attempt.id}: it is {attempt.state} and has no end time"
            continue
        if job.state in _UNPLANNED_STATES:
            yield f"print {attempt.id}: it is open, and job {job.id} is {job.state}"
        if plate.id not in job.plates:
            yield f"print {attempt.id}: it is open, but plate {plate.id} no longer belongs to job {job.id}"
        if _lacks_cancel_request(books, attempt):
            yield f"print {attempt.id}: its plate {plate.id} is cancelled, and it has no cancel request"


def _lacks_cancel_request(books: Books, attempt: Print) -> bool:
    state = books.find_plate_state(books.plates[attempt.plate])
    return state is PlateState.CANCELLED and attempt.cancel_reason is None


def _check_printers(books: Books) -> Iterator[str]:
    for name, count in Counter(p.printer for p in books.list_open_prints()).items():
        if count > 1:
            yield f"printer {name}: it has {count} open prints"
    extruding_printers = {p.printer for p in books.list_open_prints() if p.extruded}
    for printer in books.printers.values():
        if printer.reel is not None and printer.reel.grams is not None and printer.reel.grams < 0.0:
            yield f"printer {printer.name}: its reel has {printer.reel.grams:g} g"
        if printer.bed is not Bed.CLEAR:
            continue
        if printer.name in extruding_printers:
            yield f"printer {printer.name}: its bed is marked clear, but its open print has extruded"
        last_print = books.find_last_print(printer.name)
        if (
            last_print is not None
            and last_print.extruded
            and last_print.state is PrintState.DONE
            and last_print.verdict is None
        ):
            yield f"printer {printer.name}: its bed is clear, and print {last_print.id} on it is not judged"
        if (
            printer.name not in extruding_printers
            and printer.alarm is not None
            and printer.attention_reason is None
        ):
            yield f"printer {printer.name}: it has an alarm, and no inspection is requested"


def _check_outages(books: Books) -> Iterator[str]:
    open_outages = [outage.id for outage in books.outages.values() if outage.confirmed_s is None]
    if len(open_outages) > 1:
        yield f"the farm: outages {' and '.join(map(str, open_outages))} are open; at most one may be"
