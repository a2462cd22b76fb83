"""Restoration of a backup: states are marked as unknown, and agents' journals complete the books. Pure."""

from __future__ import annotations

from farm.model import Bed, FilamentState, Hold, HoldCode, Job, JobState, Key, Printer
from farm.state import events as ev
from farm.state.books import Books, put, replace_fields
from farm.state.reels import mark_reel_uncertain

RESTORE_HOLD = Hold(
    code=HoldCode.APPROVAL,
    text="the database was restored from a backup: `farm cancel` the parts that were printed since, "
    "then `farm approve` to print the rest",
)


def restore_books(event: ev.BooksRestored, books: Books) -> Books:
    """Mark every bed as not clear, and hold every job until a person has checked which parts are printed.

    All keys and sessions are revoked, because some may have been revoked since the backup.
    Prints since the backup are then added from the agents' journals (`import_agent_journal`).
    """
    printers = [_restore_printer(printer, event, books) for printer in books.printers.values()]
    prints = [replace_fields(attempt, restored=True) for attempt in books.list_open_prints()]
    jobs = [_hold_job(job) for job in books.jobs.values() if not job.state.ended]
    keys = [_revoke_key(key, event.at_s) for key in books.keys.values()]
    return put(books, *printers, *prints, *jobs, *keys)


def _restore_printer(printer: Printer, event: ev.BooksRestored, books: Books) -> Printer:
    """Return a printer whose changes since the backup are marked as unknown."""
    since_s = event.copied_s
    if printer.unreported_since_s is not None:
        since_s = min(since_s, printer.unreported_since_s)
    attempt = books.find_open_print(printer.name)
    if attempt is not None:  # it may have ended before the backup, unreported
        since_s = min(since_s, attempt.assigned_s)
    return replace_fields(
        printer,
        bed=Bed.NOT_CLEAR,
        filament=FilamentState.UNKNOWN,
        reel=mark_reel_uncertain(printer.reel),
        restored_s=event.at_s,
        unreported_since_s=since_s,
    )


def _revoke_key(key: Key, at_s: float) -> Key:
    return key if key.revoked_s is not None else replace_fields(key, revoked_s=at_s)


def _hold_job(job: Job) -> Job:
    """Return the job, held for approval, because its parts may have been printed since the backup."""
    if job.state in (JobState.QUEUED, JobState.PLANNING):
        return replace_fields(job, options=job.options.model_copy(update={"hold": True}), restored=True)
    return replace_fields(job, state=JobState.HELD, hold=RESTORE_HOLD, restored=True)


def finish_journal_import(event: ev.AgentJournalImported, books: Books) -> Books:
    """Record that an agent has listed its prints; if any match no plate, request an inspection."""
    printer = replace_fields(books.get_printer(event.printer), unreported_since_s=None)
    if event.unknown:
        prints = "a print that matches" if event.unknown == 1 else f"{event.unknown} prints that match"
        printer = replace_fields(
            printer,
            bed=Bed.UNKNOWN,
            filament=FilamentState.UNKNOWN,
            attention_reason=f"after the backup of the database it made {prints} no waiting plate: "
            "check its bed",
            attention_since_s=event.at_s,
        )
    return put(books, printer)
