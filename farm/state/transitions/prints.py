"""Rules for events about a print. Pure."""

from __future__ import annotations

from drivers.errors import Fault
from farm.model import Plate, Print, PrintState, Verdict
from farm.state import events as ev
from farm.state.books import Books, put, replace_fields
from farm.state.consequences import (
    Result,
    add_print,
    mark_bed_not_clear,
    mark_printer_lost,
    request_cancel,
    request_pause,
    update_job_state,
)
from farm.state.faults import LOSSES, UNCOUNTED_FAULTS, FarmFault
from farm.state.lifecycles import PRINT_LIFECYCLE, InvalidTransition
from farm.state.printer_speed import learn_speed
from farm.state.reels import compute_used_grams, subtract_grams
from farm.state.transitions.rules import change


@change.register
def _(event: ev.PrintProgressed, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    attempt = replace_fields(
        attempt,
        state=event.state,
        started_s=attempt.started_s if attempt.started_s is not None else event.started_s,
        extruded=attempt.extruded or event.extruded,
        paused=attempt.paused or event.state is PrintState.PAUSED,
        restored=False,
    )
    books = put(books, attempt)
    return (mark_bed_not_clear(books, attempt.printer) if attempt.extruded else books), ()


@change.register
def _(event: ev.PrintWithdrawn, books: Books) -> Result:
    cancelled_print, instruction = request_cancel(_get_uncancelled_print(event, books), event.reason)
    return put(books, cancelled_print), (instruction,)


@change.register
def _(event: ev.PauseRequested, books: Books) -> Result:
    paused_print, instruction = request_pause(_get_uncancelled_print(event, books), event.wanted)
    return put(books, paused_print), (instruction,)


@change.register
def _(event: ev.PrintFailRequested, books: Books) -> Result:
    attempt = replace_fields(_get_uncancelled_print(event, books), fail_reason=event.why)
    cancelled_print, instruction = request_cancel(attempt, event.why)
    return put(books, cancelled_print), (instruction,)


def _get_uncancelled_print(
    event: ev.PrintWithdrawn | ev.PauseRequested | ev.PrintFailRequested, books: Books
) -> Print:
    """Return the print of an event, if it has no cancel request.

    Raises
    ------
    InvalidTransition
        If the farm has requested that the print be cancelled.
    """
    attempt = books.prints[event.print_id]
    if attempt.cancel_reason is not None:
        reason = f"{attempt.state} and being stopped ({attempt.cancel_reason})"
        raise InvalidTransition(event, PRINT_LIFECYCLE, attempt.id, attempt.state, reason)
    return attempt


@change.register
def _(event: ev.StillKept, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    other_stills = tuple(still for still in attempt.stills if still.moment is not event.still.moment)
    return put(books, replace_fields(attempt, stills=(*other_stills, event.still))), ()


@change.register
def _(event: ev.PrintFound, books: Books) -> Result:
    return add_print(books, event), ()


@change.register
def _(event: ev.PrintEnded, books: Books) -> Result:
    previous = books.prints[event.print_id]
    plate, printer = books.plates[previous.plate], books.get_printer(previous.printer)
    is_unknown = _is_end_unknown(event, previous)
    attempt = _end_print(event, previous, plate)
    books = put(books, attempt)
    printer = replace_fields(
        printer, filament=event.filament, reel=subtract_grams(printer.reel, attempt.grams)
    )
    if attempt.state is PrintState.DONE and not attempt.paused:
        printer = learn_speed(books, printer, attempt)
    if attempt.state is PrintState.FAILED:
        reason = attempt.reason or attempt.fault or "its print failed"
        printer = replace_fields(printer, attention_reason=reason, attention_since_s=event.ended_s)
        if attempt.fault == Fault.ESTOP:  # the plate waits until a person resumes it
            books = put(books, replace_fields(plate, paused=True))
    books = put(books, printer)
    # A failed print may have extruded without reporting it.
    if attempt.extruded or attempt.state is PrintState.FAILED:
        books = mark_bed_not_clear(books, attempt.printer)
    books = update_job_state(books, attempt.job, event.at_s)
    if attempt.state is PrintState.FAILED and attempt.fault in LOSSES and not is_unknown:
        books = mark_printer_lost(books, attempt.printer, event.ended_s, event.at_s)
    return books, (ev.SendForget(print_id=attempt.id, printer=attempt.printer),)


def _is_end_unknown(event: ev.PrintEnded, attempt: Print) -> bool:
    """Return whether it is unknown how a restored print ended; it may have been done, for example."""
    is_lost = event.fault == FarmFault.PRINT_LOST or event.state is PrintState.CANCELLED
    return attempt.restored and is_lost


def _end_print(event: ev.PrintEnded, attempt: Print, plate: Plate) -> Print:
    """Return a print with the state, fault and filament of its end; `charged` if it counts as an attempt."""
    state, fault, reason = event.state, event.fault, event.reason
    has_started = attempt.state is not PrintState.ASSIGNED or event.started_s is not None
    if state is PrintState.CANCELLED and attempt.fail_reason is not None:
        state, fault, reason = PrintState.FAILED, FarmFault.BY_A_PERSON, attempt.fail_reason
    elif state is PrintState.CANCELLED and attempt.cancel_reason is None and has_started:
        state = PrintState.FAILED  # the farm did not request the cancellation
    # A print may end before the request to fail it reaches its agent.
    if state is PrintState.DONE and attempt.fail_reason is not None:
        attempt = replace_fields(attempt, verdict=Verdict.BAD, verdict_why=attempt.fail_reason)
    is_unknown = _is_end_unknown(event, attempt)
    has_extruded = attempt.extruded or event.extruded
    return replace_fields(
        attempt,
        state=state,
        fault=fault,
        reason=reason,
        charged=not is_unknown and attempt.cancel_reason is None and fault not in UNCOUNTED_FAULTS,
        started_s=attempt.started_s if attempt.started_s is not None else event.started_s,
        ended_s=event.ended_s,
        extruded=has_extruded,
        starved_s=event.starved_s,
        grams=compute_used_grams(plate, state, has_extruded, event.printed_share),
    )
