"""Complete parts of failed prints whose agents died before they recorded that the print was done. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from farm.model import Bed, Plate, Print, PrintState, Verdict
from farm.state.books import Books, put, replace_fields
from farm.state.consequences import Result, request_cancel, update_job_state
from farm.state.plate_state import PlateState
from farm.state.reels import subtract_grams

_MIN_TIME_SHARE = 0.8  # share of the expected time after which a plate may be complete
_UNPRINTED_STATES = (PlateState.WAITING, PlateState.PRINTING, PlateState.OUT_OF_ATTEMPTS)


def find_part_id(books: Books, ended_print: Print) -> str:
    """Return the id of the part that a print produces."""
    return books.plates[ended_print.plate].parts[0]


def find_failed_print(books: Books, printer: str) -> Print | None:
    """Return the failed or cancelled print whose part is still on a printer's bed; None if there is none."""
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
    """Return the failed print whose part on a printer's bed may be complete and is still needed; else None.

    The duration of the print decides whether the part may be complete. The progress of the print is unknown,
    because its agent died, but the next agent recorded when it switched the heaters off.
    """
    failed_print = find_failed_print(books, printer)
    if (
        failed_print is None
        or failed_print.state is not PrintState.FAILED
        or failed_print.fail_reason is not None
    ):
        return None
    if failed_print.started_s is None or failed_print.ended_s is None:
        return None
    plate = books.plates[failed_print.plate]
    factor = books.get_printer(printer).time_factors.compute_factor(plate.feature_shares)
    min_duration_s = _MIN_TIME_SHARE * plate.sliced_s * factor
    if failed_print.ended_s - failed_print.started_s < min_duration_s:
        return None
    is_needed = any(
        books.find_plate_state(plate) in _UNPRINTED_STATES
        for plate in list_plates_of_print(books, failed_print)
    )
    return failed_print if is_needed else None


def list_reprinting_printers(books: Books, original_print: Print) -> list[str]:
    """List the printers that are printing the part of a print again."""
    return sorted(
        reprint.printer for reprint in _list_reprints(books, original_print) if reprint.cancel_reason is None
    )


def list_plates_of_print(books: Books, original_print: Print) -> Iterator[Plate]:
    """Yield the plates to which a print belongs: several if its part was cut into smaller parts."""
    return (p for p in books.list_plates(books.jobs[original_print.job]) if original_print.id in p.prints)


def _list_reprints(books: Books, original_print: Print) -> list[Print]:
    prints = (p for plate in list_plates_of_print(books, original_print) for p in books.list_prints(plate))
    return list({p.id: p for p in prints if p.id != original_print.id and not p.state.ended}.values())


def record_complete_part(books: Books, print_id: str, caller_name: str, at_s: float) -> Result:
    """Record a failed print as done and good, and cancel the reprints of its part that have not started."""
    failed_print = books.prints[print_id]
    plate, printer = books.plates[failed_print.plate], books.get_printer(failed_print.printer)
    failure = failed_print.reason or failed_print.fault or "it failed"
    completed_print = replace_fields(
        failed_print,
        state=PrintState.DONE,
        fault=None,
        reason=None,
        verdict=Verdict.GOOD,
        verdict_why=f"confirmed good by {caller_name}, though its print failed: {failure}",
        grams=plate.grams,
    )
    reel = subtract_grams(printer.reel, plate.grams - failed_print.grams)
    unstarted_reprints = [p for p in _list_reprints(books, failed_print) if p.state is PrintState.ASSIGNED]
    cancellations = [
        request_cancel(p, f"{find_part_id(books, failed_print)} was confirmed good")
        for p in unstarted_reprints
    ]
    books = put(books, completed_print, replace_fields(printer, reel=reel), *(p for p, _ in cancellations))
    return update_job_state(books, failed_print.job, at_s), tuple(
        instruction for _, instruction in cancellations
    )
