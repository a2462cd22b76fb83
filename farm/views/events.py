"""Views of the event log. Pure."""

from __future__ import annotations

from farm import api
from farm.state.event_rows import EventRow
from farm.views.context import ViewContext


def describe_event(context: ViewContext, row: EventRow) -> api.EventView:
    """Describe an event; job, plate and printer of a print that it names are added."""
    attempt = context.books.prints.get(row.print_id or "")
    plate = context.books.plates.get(row.plate or "")
    plate_or_print = attempt or plate
    return api.EventView(
        number=row.number,
        at=context.format_time(row.at_s) or "",
        kind=row.kind,
        job=plate_or_print.job if row.job is None and plate_or_print is not None else row.job,
        plate=row.plate or (attempt.plate if attempt is not None else None),
        printer=row.printer or (attempt.printer if attempt is not None else None),
        print_id=row.print_id,
        by=row.by,
        state=row.state,
        reason=row.reason,
    )
