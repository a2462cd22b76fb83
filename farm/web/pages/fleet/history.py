"""History page with figures of ended prints and filters. Pure."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated
from urllib.parse import urlencode

from pydantic import BaseModel, Field

from farm.views.dashboard import HistoryFilter, HistoryView
from farm.web.notes import Note, Reader
from farm.web.pages.page_route import EMPTY_IS_NONE
from farm.web.pages.rendering import Farm, render_page

PERIODS = ((None, "all"), (1, "last day"), (7, "last 7 days"), (30, "last 30 days"), (365, "last year"))
"""Periods to choose from, each as a number of days and a label."""


class HistoryQuery(BaseModel):
    """Filter of prints in the page's URL; an empty field does not filter."""

    days: Annotated[Annotated[int, Field(ge=1, le=36_500)] | None, EMPTY_IS_NONE] = None
    printer: Annotated[Annotated[str, Field(max_length=100)] | None, EMPTY_IS_NONE] = None
    job: Annotated[Annotated[int, Field(ge=1, le=2**31)] | None, EMPTY_IS_NONE] = None

    def to_filter(self) -> HistoryFilter:
        """Return the filter of the view."""
        return HistoryFilter(days=self.days, printer=self.printer, job=self.job)


def render_history(view: HistoryView, farm: Farm, reader: Reader, note: Note | None = None) -> str:
    """Render the page.

    Parameters
    ----------
    view
        Ended prints, with figures.
    farm
        The fleet.
    reader
        Person who reads the page.
    note
        Message about the reader's last action.
    """
    values = asdict(view.history_filter)
    query = urlencode({name: value for name, value in values.items() if value is not None})
    return render_page(
        "history.html",
        farm,
        "/history",
        reader,
        note,
        view=view,
        periods=PERIODS,
        query=f"?{query}" if query else "",
    )
