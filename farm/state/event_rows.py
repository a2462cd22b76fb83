"""Rows of the event log with the fields that all users may see. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class EventRow:
    """Event without confidential fields, such as hashes of keys and names of stored files.

    Attributes
    ----------
    number
        Number of the event in the log.
    at_s
        Time of the event, on the farm's clock.
    kind
        Name of the event's class.
    job, plate, printer, print_id
        Entities that the event names; None for each that it does not name.
    by
        Name of the person, or of the key, that caused the event.
    state, reason
        New state of a print, and the reason.
    """

    number: int
    at_s: float
    kind: str
    job: int | None = None
    plate: str | None = None
    printer: str | None = None
    print_id: str | None = None
    by: str | None = None
    state: str | None = None
    reason: str | None = None


_JOB_PATH = "CASE json_type(body, '$.job') WHEN 'object' THEN '$.job.id' ELSE '$.job' END"
_FIELD_EXPRESSIONS = (
    f"json_extract(body, {_JOB_PATH})",
    "json_extract(body, '$.plate')",
    "json_extract(body, '$.printer')",
    "json_extract(body, '$.print_id')",
    "coalesce(json_extract(body, '$.by'), json_extract(body, '$.job.submitted_by'),"
    " json_extract(body, '$.key.by'))",
    "json_extract(body, '$.state')",
    "coalesce(json_extract(body, '$.reason'), json_extract(body, '$.why'), json_extract(body, '$.fault'))",
)
EVENTS_QUERY = (
    f"SELECT seq, at_s, kind, {', '.join(_FIELD_EXPRESSIONS)} FROM event WHERE seq > ? ORDER BY seq LIMIT ?"
)
"""Query for events after a number, up to a limit. SQLite extracts the fields, because bodies may be large."""
_PRINTER_EVENTS = (
    "MaintenanceStarted",
    "MaintenanceEnded",
    "ReelLoaded",
    "PrinterLost",
    "PrinterAlarmed",
    "BedBecameUnknown",
)
_MAX_SEARCHED_ROWS = 20_000
PRINTER_QUERY = (
    f"SELECT seq, at_s, kind, {', '.join(_FIELD_EXPRESSIONS)} FROM event "
    f"WHERE seq > (SELECT coalesce(max(seq), 0) FROM event) - {_MAX_SEARCHED_ROWS} "
    f"AND kind IN ({', '.join(repr(kind) for kind in _PRINTER_EVENTS)}) "
    "AND json_extract(body, '$.printer') = ? "
    "ORDER BY seq DESC LIMIT ?"
)
"""Query for maintenance, reels, losses and alarms of a printer, newest first, in the last 20,000 events."""


def make_row(values: Sequence[Any]) -> EventRow:
    """Make a row from the values of `EVENTS_QUERY`. Values of other types, from old versions, become None."""
    number, at_s, kind, job, *texts = values
    plate, printer, print_id, by, state, reason = (text if isinstance(text, str) else None for text in texts)
    return EventRow(
        number, at_s, kind, job if isinstance(job, int) else None, plate, printer, print_id, by, state, reason
    )
