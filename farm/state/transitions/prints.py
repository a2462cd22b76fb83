"""Rules for events about a print, and updates of a printer's time factor. Pure."""

from __future__ import annotations

from drivers.errors import Fault
from farm.model import Plate, Print, Printer, PrintState, Verdict
from farm.state import events as ev
from farm.state import restore
from farm.state.books import Books, put, replace_fields
from farm.state.consequences import (
    Result,
    mark_bed_not_clear,
    mark_printer_lost,
    request_cancel,
    request_pause,
    update_job_state,
)
from farm.state.faults import LOSSES, UNCHARGED, OwnFault
from farm.state.lifecycles import PRINT, InvalidTransition
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
    cancelled_print, stop = request_cancel(_require_not_ending(event, books), event.reason)
    return put(books, cancelled_print), (stop,)


@change.register
def _(event: ev.PauseRequested, books: Books) -> Result:
    paused_print, send = request_pause(_require_not_ending(event, books), event.wanted)
    return put(books, paused_print), (send,)


@change.register
def _(event: ev.PrintFailRequested, books: Books) -> Result:
    attempt = replace_fields(_require_not_ending(event, books), fail_reason=event.why)
    cancelled_print, stop = request_cancel(attempt, event.why)
    return put(books, cancelled_print), (stop,)


def _require_not_ending(
    event: ev.PrintWithdrawn | ev.PauseRequested | ev.PrintFailRequested, books: Books
) -> Print:
    """Return the print of an event, which must not be ending.

    Raises
    ------
    InvalidTransition
        If its agent was sent a cancel request.
    """
    attempt = books.prints[event.print_id]
    if attempt.cancel_reason is not None:
        reason = f"{attempt.state} and being ended ({attempt.cancel_reason})"
        raise InvalidTransition(event, PRINT, attempt.id, attempt.state, reason)
    return attempt


@change.register
def _(event: ev.StillKept, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    others = tuple(still for still in attempt.stills if still.moment is not event.still.moment)
    return put(books, replace_fields(attempt, stills=(*others, event.still))), ()


@change.register
def _(event: ev.PrintFound, books: Books) -> Result:
    return restore.book_found_print(event, books), ()


@change.register
def _(event: ev.PrintEnded, books: Books) -> Result:
    previous = books.prints[event.print_id]
    plate, printer = books.plates[previous.plate], books.printer(previous.printer)
    unknown = _is_end_unknown(event, previous)
    attempt = _end_print(event, previous, plate)
    printer = replace_fields(
        printer, filament=event.filament, reel=subtract_grams(printer.reel, attempt.grams)
    )
    if attempt.state is PrintState.DONE and attempt.started_s is not None and not attempt.paused:
        printer = _learn_speed(printer, plate, attempt, event.ended_s - attempt.started_s)
    if attempt.state is PrintState.FAILED:
        reason = attempt.reason or attempt.fault or "its print failed"
        printer = replace_fields(printer, attention_reason=reason, attention_since_s=event.ended_s)
        if attempt.fault == Fault.ESTOP:  # its plate waits until a person resumes it
            books = put(books, replace_fields(plate, paused=True))
    books = put(books, attempt, printer)
    # A failed print may have extruded without reporting it.
    if attempt.extruded or attempt.state is PrintState.FAILED:
        books = mark_bed_not_clear(books, attempt.printer)
    books = update_job_state(books, attempt.job, event.at_s)
    if attempt.state is PrintState.FAILED and attempt.fault in LOSSES and not unknown:
        books = mark_printer_lost(books, attempt.printer, event.ended_s, event.at_s)
    return books, (ev.SendForget(print_id=attempt.id, printer=attempt.printer),)


def _is_end_unknown(event: ev.PrintEnded, attempt: Print) -> bool:
    """Return whether a restored print may have been done, or ended by a person, since the backup."""
    is_lost = event.fault == OwnFault.PRINT_LOST or event.state is PrintState.CANCELLED
    return attempt.restored and is_lost


def _end_print(event: ev.PrintEnded, attempt: Print, plate: Plate) -> Print:
    """Return an ended print, with its state, fault, charge and filament."""
    state, fault, reason = event.state, event.fault, event.reason
    has_started = attempt.state is not PrintState.ASSIGNED or event.started_s is not None
    if state is PrintState.CANCELLED and attempt.fail_reason is not None:
        state, fault, reason = PrintState.FAILED, OwnFault.BY_A_PERSON, attempt.fail_reason
    elif state is PrintState.CANCELLED and attempt.cancel_reason is None and has_started:
        state = PrintState.FAILED  # not requested by the farm
    # The print ended before the request reached its agent.
    if state is PrintState.DONE and attempt.fail_reason is not None:
        attempt = replace_fields(attempt, verdict=Verdict.BAD, verdict_why=attempt.fail_reason)
    unknown = _is_end_unknown(event, attempt)
    has_extruded = attempt.extruded or event.extruded
    return replace_fields(
        attempt,
        state=state,
        fault=fault,
        reason=reason,
        charged=not unknown and attempt.cancel_reason is None and fault not in UNCHARGED,
        started_s=attempt.started_s if attempt.started_s is not None else event.started_s,
        ended_s=event.ended_s,
        extruded=has_extruded,
        starved_s=event.starved_s,
        grams=compute_used_grams(plate, state, has_extruded, event.printed_share),
    )


def _learn_speed(printer: Printer, plate: Plate, attempt: Print, took_s: float) -> Printer:
    """Return a printer with its time factor updated by a finished print."""
    reached_s = took_s - plate.prelude_s
    factor = update_time_factor(printer.time_factor, plate.sliced_s, reached_s, attempt.starved_s)
    return replace_fields(printer, time_factor=factor)


MIN_TIME_FACTOR, MAX_TIME_FACTOR = 0.8, 1.25
"""Limits of the time factor of a healthy printer."""
MIN_LEARNED_S = 600.0
"""Least duration of a print that updates the factor: in shorter ones the heat-up dominates."""
MAX_STARVED_SHARE = 0.01
"""Largest share of a print for which a simulated printer may have waited for its host."""
_IMPLAUSIBLE_RATIO = 2.0
_STEP = 0.1
_WEIGHT = 0.25


def update_time_factor(factor: float, expected_s: float, reached_s: float, starved_s: float = 0.0) -> float:
    """Update a printer's factor by one print: an exponentially weighted mean of bounded steps.

    Parameters
    ----------
    factor
        The factor so far; 1 at first.
    expected_s
        Seconds of the layers by the slicer, without a factor.
    reached_s
        Seconds that the layers took, without heat-up, start and end code.
    starved_s
        Part of `reached_s` for which a simulated printer waited for its host.

    Returns
    -------
    float
        New factor, between MIN_TIME_FACTOR and MAX_TIME_FACTOR, and at most 1/40 away from `factor`. A print
        that took less than half or more than twice the expected time is ignored: it was paused, or the clock
        was set.
    """
    if expected_s < MIN_LEARNED_S or reached_s <= 0.0 or starved_s > MAX_STARVED_SHARE * reached_s:
        return factor
    ratio = reached_s / expected_s
    if not 1 / _IMPLAUSIBLE_RATIO < ratio < _IMPLAUSIBLE_RATIO:
        return factor
    step = min(_STEP, max(-_STEP, ratio - factor))
    return min(MAX_TIME_FACTOR, max(MIN_TIME_FACTOR, factor + _WEIGHT * step))
