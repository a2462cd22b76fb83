"""Views of the event log. Pure."""

from __future__ import annotations

from datetime import datetime, tzinfo

from farm import api
from farm.state import Books
from farm.state.event_rows import EventRow


def describe_event(books: Books, zone: tzinfo, row: EventRow) -> api.EventView:
    """Describe an event, with its time in a time zone, and with the job, plate and printer of its print."""
    attempt = books.prints.get(row.print_id or "")
    plate = books.plates.get(row.plate or "")
    plate_or_print = attempt or plate
    return api.EventView(
        number=row.number,
        at=datetime.fromtimestamp(row.at_s, zone).isoformat("T", "seconds"),
        kind=row.kind,
        job=plate_or_print.job if row.job is None and plate_or_print is not None else row.job,
        plate=row.plate or (attempt.plate if attempt is not None else None),
        printer=row.printer or (attempt.printer if attempt is not None else None),
        print_id=row.print_id,
        by=row.by,
        state=row.state,
        reason=row.reason,
    )
