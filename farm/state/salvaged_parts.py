"""Complete parts of failed prints, whose agents died before they recorded the end. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from farm.model import Bed, Plate, Print, PrintState, Verdict
from farm.state.books import Books, put, replace_fields
from farm.state.consequences import Result, request_cancel, update_job_state
from farm.state.plate_state import PlateState
from farm.state.reels import subtract_grams

_MIN_TIME_SHARE = 0.8  # minimum share of the expected time after which a plate may be complete
_UNPRINTED_STATES = (PlateState.WAITING, PlateState.PRINTING, PlateState.OUT_OF_ATTEMPTS)


def find_part_id(books: Books, attempt: Print) -> str:
    """Return the id of the part that a print produces."""
    return books.plates[attempt.plate].parts[0]


def find_failed_print(books: Books, printer: str) -> Print | None:
    """Return the failed or cancelled print whose part is on a bed; None if there is none."""
    last_print = books.find_last_print(printer)
    if (
        last_print is None
        or books.find_open_print(printer) is not None
        or books.get_printer(printer).bed is Bed.CLEAR
    ):
        return None
    return (
        last_print
        if last_print.state in (PrintState.FAILED, PrintState.CANCELLED) and last_print.extruded
        else None
    )


def find_possibly_complete_print(books: Books, printer: str) -> Print | None:
    """Return the failed print whose part, still on the bed, may be complete and is needed; else None.

    It is judged by its duration. Its progress is unknown, because its agent died, but the next agent
    recorded the time at which it switched the heaters off.
    """
    attempt = find_failed_print(books, printer)
    if attempt is None or attempt.state is not PrintState.FAILED or attempt.fail_reason is not None:
        return None
    if attempt.started_s is None or attempt.ended_s is None:
        return None
    plate = books.plates[attempt.plate]
    factor = books.get_printer(printer).time_factors.compute_factor(plate.feature_shares)
    min_duration_s = _MIN_TIME_SHARE * plate.sliced_s * factor
    if attempt.ended_s - attempt.started_s < min_duration_s:
        return None
    is_missing = any(
        books.find_plate_state(plate) in _UNPRINTED_STATES for plate in list_attempted_plates(books, attempt)
    )
    return attempt if is_missing else None


def list_reprinting_printers(books: Books, attempt: Print) -> list[str]:
    """Return the printers with a reprint of a print's part."""
    return sorted(
        reprint.printer for reprint in _list_reprints(books, attempt) if reprint.cancel_reason is None
    )


def list_attempted_plates(books: Books, attempt: Print) -> Iterator[Plate]:
    """Yield the plates that list a print among their attempts; several if its part was recut."""
    return (p for p in books.list_plates(books.jobs[attempt.job]) if attempt.id in p.prints)


def _list_reprints(books: Books, attempt: Print) -> list[Print]:
    attempts = (p for plate in list_attempted_plates(books, attempt) for p in books.list_prints(plate))
    return list({p.id: p for p in attempts if p.id != attempt.id and not p.state.ended}.values())


def record_complete_part(books: Books, print_id: str, caller_name: str, at_s: float) -> Result:
    """Record a failed print as done and good. Reprints that have not started are withdrawn."""
    attempt = books.prints[print_id]
    plate, printer = books.plates[attempt.plate], books.get_printer(attempt.printer)
    failure = attempt.reason or attempt.fault or "it failed"
    completed_print = replace_fields(
        attempt,
        state=PrintState.DONE,
        fault=None,
        reason=None,
        verdict=Verdict.GOOD,
        verdict_why=f"confirmed good by {caller_name}, though its print failed: {failure}",
        grams=plate.grams,
    )
    reel = subtract_grams(printer.reel, plate.grams - attempt.grams)
    reprints = [p for p in _list_reprints(books, attempt) if p.state is PrintState.ASSIGNED]
    cancellations = [
        request_cancel(p, f"{find_part_id(books, attempt)} was confirmed good") for p in reprints
    ]
    books = put(books, completed_print, replace_fields(printer, reel=reel), *(p for p, _ in cancellations))
    return update_job_state(books, attempt.job, at_s), tuple(stop for _, stop in cancellations)
