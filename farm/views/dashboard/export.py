"""Ended prints as CSV, for spreadsheets. Pure."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from io import StringIO

from farm import api
from farm.text import flatten_text

_FORMULA_PREFIXES = ("=", "+", "-", "@", "\t", "\r")  # first characters of formulas in spreadsheets
_COLUMNS = (
    *("job", "name", "part", "printer", "state", "verdict", "fault", "reason", "why"),
    *("started", "ended", "took_s", "expected_s", "grams", "wasted", "submitted_by", "note"),
    *("assembled", "assembly_s"),
)


def write_csv(rows: Iterable[api.HistoryRow]) -> str:
    """Write prints as CSV (RFC 4180) with a line of headings; durations in seconds.

    Text that a spreadsheet would take for a formula is prefixed with an apostrophe, because any user
    chooses the names of models and notes.
    """
    text = StringIO()
    writer = csv.writer(text)
    writer.writerow(_COLUMNS)
    for row in rows:
        writer.writerow([_format_cell(getattr(row, column)) for column in _COLUMNS])
    return text.getvalue()


def _format_cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f"{value:.10g}"
    text = flatten_text(str(value))
    return f"'{text}" if text.lstrip().startswith(_FORMULA_PREFIXES) else text
