"""Rules for events about a printer, or the farm as a whole. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from farm.model import Bed, FilamentState, HostLoss, Printer, Verdict
from farm.state import events as ev
from farm.state import restore
from farm.state.books import Books, put, replace_fields
from farm.state.consequences import Result, mark_printer_lost, shift_print_times, update_job_state
from farm.state.lifecycles import InvalidTransition
from farm.state.outage import find_first_host_loss_s
from farm.state.salvaged_parts import record_complete_part
from farm.state.transitions.rules import change


@change.register
def _(event: ev.PrinterAdded, books: Books) -> Result:
    return put(books, Printer(name=event.printer, bed=event.bed)), ()


@change.register
def _(event: ev.BedCleared, books: Books) -> Result:
    printer = books.get_printer(event.printer)
    filament = event.filament or printer.filament
    judged_print = books.find_print_to_judge(printer.name)
    books = put(
        books, replace_fields(printer, bed=Bed.CLEAR, attention_reason=None, alarm=None, filament=filament)
    )
    if judged_print is not None:
        books = put(books, replace_fields(judged_print, verdict=event.verdict, verdict_why=event.why))
        books = update_job_state(books, judged_print.job, event.at_s)
    if event.verdict is Verdict.GOOD:
        for attempt in list(books.list_unjudged_restored_prints(printer.name)):
            books = put(books, replace_fields(attempt, verdict=Verdict.GOOD))
            books = update_job_state(books, attempt.job, event.at_s)
    instructions: tuple[ev.AnyInstruction, ...] = ()
    if event.whole is not None:
        books, instructions = record_complete_part(books, event.whole, event.by, event.at_s)
    return books, (*instructions, ev.SendCleared(printer=printer.name, filament=event.filament))


@change.register
def _(event: ev.BedReported, books: Books) -> Result:
    printer = books.get_printer(event.printer)
    bed = event.bed if printer.bed is Bed.UNKNOWN else printer.bed
    filament = event.filament if printer.filament is FilamentState.UNKNOWN else printer.filament
    return put(books, replace_fields(printer, bed=bed, filament=filament)), ()


@change.register
def _(event: ev.BedBecameUnknown, books: Books) -> Result:
    printer = _request_inspection(event, books)
    return put(books, replace_fields(printer, bed=Bed.UNKNOWN, filament=FilamentState.UNKNOWN)), ()


@change.register
def _(event: ev.PrinterAlarmed, books: Books) -> Result:
    printer = _request_inspection(event, books)
    return put(books, replace_fields(printer, alarm=event.reason, alarm_s=event.at_s)), ()


def _request_inspection(event: ev.BedBecameUnknown | ev.PrinterAlarmed, books: Books) -> Printer:
    """Return the printer of an event, marked for inspection with the event's reason."""
    printer = books.get_printer(event.printer)
    return replace_fields(printer, attention_reason=event.reason, attention_since_s=event.at_s)


@change.register
def _(event: ev.PrinterLost, books: Books) -> Result:
    return mark_printer_lost(books, event.printer, event.at_s, event.at_s), ()


@change.register
def _(event: ev.ReelLoaded, books: Books) -> Result:
    return put(books, replace_fields(books.get_printer(event.printer), reel=event.reel)), ()


@change.register
def _(event: ev.MaintenanceStarted, books: Books) -> Result:
    return put(books, replace_fields(books.get_printer(event.printer), maintenance=event.why)), ()


@change.register
def _(event: ev.MaintenanceEnded, books: Books) -> Result:
    return put(
        books, replace_fields(books.get_printer(event.printer), maintenance=None, attention_reason=None)
    ), ()


@change.register
def _(event: ev.AgentJournalImported, books: Books) -> Result:
    return restore.finish_journal_import(event, books), ()


@change.register
def _(event: ev.ClockSet, books: Books) -> Result:
    return shift_print_times(books, event.by_s), ()


@change.register
def _(event: ev.BooksRestored, books: Books) -> Result:
    return restore.restore_books(event, books), ()


@change.register
def _(event: ev.OutageConfirmed, books: Books) -> Result:
    if books.outage is None:
        raise InvalidTransition(event, None, None, None, "not in an outage")
    return put(books, replace_fields(books.outage, confirmed_s=event.at_s)), ()


@change.register
def _(event: ev.HostLost, books: Books) -> Result:
    losses = [printer.host_loss for printer in books.printers.values() if printer.host_loss is not None]
    at_s = find_first_host_loss_s(event.at_s, losses, books.outage_window_s)
    loss = HostLoss(host=event.host, at_s=at_s, reason=event.reason)
    return _set_host_loss(books, event.printers, loss), ()


@change.register
def _(event: ev.HostConnected, books: Books) -> Result:
    return _set_host_loss(books, event.printers, None), ()


def _set_host_loss(books: Books, names: Iterable[str], loss: HostLoss | None) -> Books:
    """Record that the host of some printers is lost, or, if `loss` is None, that it is connected again."""
    printers = (books.printers[name] for name in names if name in books.printers)
    return put(books, *(replace_fields(printer, host_loss=loss) for printer in printers))


@change.register
def _(event: ev.EventsCompacted, books: Books) -> Result:
    return books, ()  # the store deletes events; the entities stay
