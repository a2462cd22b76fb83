"""Notices for people who are away, derived from the books. Pure.

Each notice has a unique key, by which the sender avoids sending it twice.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from farm.model import JobState, PrintState
from farm.state import FAULTS_BY_PEOPLE, Books
from farm.text import format_count, format_duration
from farm.views.host_losses import describe_lost_hosts, group_host_losses

_UNFINISHED_STATES = (JobState.QUEUED, JobState.PLANNING, JobState.HELD, JobState.PRINTING)


@dataclass(frozen=True, slots=True)
class Notice:
    """Sentence that informs people of an event, with the time of the event."""

    key: str
    at_s: float
    text: str
    is_urgent: bool = False  # sent without delay


def list_due_notices(books: Books, now_s: float, since_s: float, sent_keys: Collection[str]) -> list[Notice]:
    """List the notices to send now, oldest first.

    Notices that are not urgent are delayed by the outage window: further losses within it may show that the
    event is part of an outage, which has a single notice.

    Parameters
    ----------
    books
        The books.
    now_s, since_s
        Farm time, and the time before which events cause no notices, in seconds since the epoch.
    sent_keys
        Keys of the notices already sent.
    """
    notices = [
        *_list_alarm_notices(books),
        *_list_job_notices(books),
        *_list_failure_notices(books),
        *_list_loss_notices(books),
        *_list_host_loss_notices(books),
        *_list_restoration_notices(books),
        *_list_final_notices(books),
    ]
    # The absolute difference, because the clock may have been set back.
    due_notices = (n for n in notices if n.is_urgent or abs(now_s - n.at_s) >= books.outage_window_s)
    new_notices = (n for n in due_notices if since_s <= n.at_s and n.key not in sent_keys)
    return sorted(new_notices, key=lambda notice: (notice.at_s, notice.key))


def _list_alarm_notices(books: Books) -> Iterator[Notice]:
    for printer in books.printers.values():
        if printer.alarm is not None and printer.alarm_s is not None:
            text = f"go to {printer.name} now: {printer.alarm}"
            yield Notice(f"alarm {printer.name} {printer.alarm_s:.3f}", printer.alarm_s, text, is_urgent=True)


def _list_job_notices(books: Books) -> Iterator[Notice]:
    for job in books.jobs.values():
        if job.ended_s is None or job.options.dry_run:
            continue
        title = f"job {job.id} ({job.name})"
        if job.state in (JobState.PRINTED, JobState.DONE):
            prints = (attempt for plate in books.list_plates(job) for attempt in books.list_prints(plate))
            start_s = min((p.started_s for p in prints if p.started_s is not None), default=job.ended_s)
            parts = format_count(len(job.parts), "part")
            text = f"{title} is printed: {parts} in {format_duration(job.ended_s - start_s)}"
            yield Notice(f"job {job.id} printed {job.ended_s:.0f}", job.ended_s, text)
        elif job.state is JobState.FAILED:
            yield Notice(
                f"job {job.id} failed {job.ended_s:.0f}", job.ended_s, f"{title} failed: {job.reason}"
            )


def _list_failure_notices(books: Books) -> Iterator[Notice]:
    for attempt in books.prints.values():
        has_failed = attempt.state is PrintState.FAILED and attempt.fault not in FAULTS_BY_PEOPLE
        if (
            not has_failed
            or attempt.ended_s is None
            or _is_in_outage(books, attempt.printer, attempt.ended_s)
        ):
            continue
        part = books.plates[attempt.plate].parts[0]
        reason = attempt.reason or attempt.fault
        yield Notice(f"print {attempt.id}", attempt.ended_s, f"{part} failed on {attempt.printer}: {reason}")


def _list_loss_notices(books: Books) -> Iterator[Notice]:
    for outage in books.outages.values():
        text = f"{' '.join(outage.printers)} were lost at the same time; nothing starts before `farm resume`"
        yield Notice(f"outage {outage.id}", outage.at_s, text)
    # A loss that ended a print is part of the notice of the failed print.
    failed_print_ends = {
        (attempt.printer, attempt.ended_s)
        for attempt in books.prints.values()
        if attempt.state is PrintState.FAILED
    }
    for printer in books.printers.values():
        name, disconnected_at_s = printer.name, printer.disconnected_at_s
        if (
            disconnected_at_s is None
            or (name, disconnected_at_s) in failed_print_ends
            or _is_in_outage(books, name, disconnected_at_s)
        ):
            continue
        yield Notice(
            f"lost {name} {disconnected_at_s:.0f}",
            disconnected_at_s,
            f"{name} is lost: the connection to its board is gone",
        )


def _list_host_loss_notices(books: Books) -> Iterator[Notice]:
    """Yield one notice for all hosts that were lost together."""
    for at_s, losses in group_host_losses(books).items():
        yield Notice(f"hosts {at_s:.0f}", at_s, describe_lost_hosts(losses))


def _list_restoration_notices(books: Books) -> Iterator[Notice]:
    moments = [p.restored_s for p in books.printers.values() if p.restored_s is not None]
    if moments:
        text = "the database was damaged and restored from a backup: clear every bed, then approve every job"
        yield Notice(f"restored {max(moments):.0f}", max(moments), text)


def _list_final_notices(books: Books) -> Iterator[Notice]:
    jobs = [job for job in books.jobs.values() if not job.options.dry_run]
    ended_s = max((job.ended_s for job in jobs if job.ended_s is not None), default=None)
    if ended_s is not None and not any(job.state in _UNFINISHED_STATES for job in jobs):
        yield Notice(f"nothing left {ended_s:.0f}", ended_s, "all jobs have ended")


def _is_in_outage(books: Books, printer: str, at_s: float) -> bool:
    """Return whether a loss is part of an outage, which has one notice for all of its printers."""
    return any(
        printer in outage.printers
        and at_s >= outage.at_s - books.outage_window_s
        and (outage.confirmed_s is None or at_s <= outage.confirmed_s)
        for outage in books.outages.values()
    )
