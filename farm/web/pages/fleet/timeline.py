"""Page of the fleet's timeline, with the effect of a what-if change to a job. Pure."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal
from urllib.parse import urlencode
from zoneinfo import ZoneInfo

from pydantic import BaseModel, Field

from farm import api
from farm.errors import Refused
from farm.text import format_duration
from farm.views.dashboard import Change, TimelineView
from farm.web.notes import Note, Reader
from farm.web.pages.page_route import EMPTY_IS_NONE
from farm.web.pages.rendering import Farm, render_page

RANGES = ((6, "6 hours"), (12, "12 hours"), (24, "day"), (72, "3 days"), (168, "week"))
"""Periods before now that the page can show, each as a number of hours and a label."""
MOVES = (("", "unchanged"), ("first", "first"), ("up", "one up"), ("down", "one down"), ("last", "last"))
"""What-if moves of a job, each as a value of `api.QueuePlace` and a label."""


class TimelineQuery(BaseModel):
    """Query of the page: the period before now that it shows, and a what-if change."""

    hours: Literal["6", "12", "24", "72", "168"] = "12"
    job: Annotated[Annotated[int, Field(ge=1, le=2**31)] | None, EMPTY_IS_NONE] = None
    to: Annotated[api.QueuePlace | None, EMPTY_IS_NONE] = None
    at: Annotated[str, Field(max_length=40)] = ""

    @property
    def past_s(self) -> float:
        """Length of the period before now that the page shows, in seconds."""
        return int(self.hours) * 3600.0

    def format_query(self) -> str:
        """Format the query for a URL."""
        return urlencode(self.model_dump(exclude_defaults=True))

    def check(self) -> None:
        """Raise Refused if a job is named without a change, or a change without a job."""
        if self.job is None and (self.to or self.at):
            raise Refused("choose a job")
        if self.job is not None and not (self.to or self.at):
            raise Refused("choose another place in the queue, or another start")


def render_timeline(
    view: TimelineView,
    query: TimelineQuery,
    farm: Farm,
    reader: Reader,
    note: Note | None = None,
    problem: str | None = None,
) -> str:
    """Render the page.

    Parameters
    ----------
    view
        The timeline.
    query
        The query of the page.
    farm
        The fleet.
    reader
        Person who reads the page.
    note
        Message about the reader's last action.
    problem
        Reason why the change cannot be made.
    """
    return render_page(
        "timeline.html",
        farm,
        "/timeline",
        reader,
        note,
        view=view,
        problem=problem,
        ranges=RANGES,
        moves=MOVES,
        move=query.to or "",
        at=query.at,
        address=f"/timeline?{query.format_query()}",
        start=format_start(view),
        change_text=describe_change(view.change, query),
        describe_shift=describe_shift,
    )


def format_start(view: TimelineView) -> str:
    """Format the what-if start with its date; empty if there is no what-if start.

    Without the date, `22:00` would mean a different day tomorrow.
    """
    if view.change is None or view.change.not_before_s is None:
        return ""
    return datetime.fromtimestamp(view.change.not_before_s, ZoneInfo(view.zone)).isoformat(" ", "minutes")


def describe_change(change: Change | None, query: TimelineQuery) -> str:
    """Describe the what-if change in a few words."""
    if change is None:
        return ""
    place = f"{dict(MOVES)[query.to]} in the queue" if query.to else ""
    start = f"starting no earlier than {query.at}" if query.at else ""
    return f"job {change.job} {' and '.join(filter(None, (place, start)))}"


def describe_shift(delay_s: float | None) -> str:
    """Describe how much later or earlier a job ends."""
    if delay_s is None:
        return "–"
    if abs(delay_s) < 60.0:
        return "the same"
    return f"{format_duration(abs(delay_s))} {'later' if delay_s > 0 else 'earlier'}"
