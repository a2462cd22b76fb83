"""Events of a daemon's start: new printers, a restored database, plans of an earlier daemon. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from farm.config import Fleet
from farm.model import Bed, JobState
from farm.state import Books
from farm.state import events as ev


def list_startup_events(
    books: Books, fleet: Fleet, restored_s: float | None, now_s: float
) -> Iterator[ev.AnyEvent]:
    """Yield the events of a start.

    Parameters
    ----------
    books, fleet
        The books and the fleet, as loaded.
    restored_s
        Time of the backup, if the database was damaged and restored from one.
    now_s
        Farm time, seconds since the epoch.
    """
    for section in fleet.printers:
        if section.name not in books.printers:
            bed = Bed.UNKNOWN if section.simulated else Bed.NOT_CLEAR
            yield ev.PrinterAdded(at_s=now_s, printer=section.name, bed=bed)
    if restored_s is not None:
        yield ev.BooksRestored(at_s=now_s, copied_s=restored_s)
    for job in books.jobs.values():
        if job.state is JobState.PLANNING:
            yield ev.PlanningAbandoned(at_s=now_s, job=job.id, hold=None)
