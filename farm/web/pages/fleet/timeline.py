"""Page of the fleet's timeline, and of what a change to a job would do. Pure."""

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
"""Lengths of the shown past: hours, and words."""
MOVES = (("", "as it is"), ("first", "first"), ("up", "one up"), ("down", "one down"), ("last", "last"))
"""Moves of a job to try out: values of `api.QueuePlace`, and words."""


class TimelineQuery(BaseModel):
    """Address of the page: how far it goes back, and a change to try out."""

    hours: Literal["6", "12", "24", "72", "168"] = "12"
    job: Annotated[Annotated[int, Field(ge=1, le=2**31)] | None, EMPTY_IS_NONE] = None
    to: Annotated[api.QueuePlace | None, EMPTY_IS_NONE] = None
    at: Annotated[str, Field(max_length=40)] = ""

    @property
    def past_s(self) -> float:
        """Return the length of the shown past, in seconds."""
        return int(self.hours) * 3600.0

    def write(self) -> str:
        """Return it as it stands in an address."""
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
        The query of the address.
    farm
        The fleet.
    reader
        Person who reads it.
    note
        Message about the reader's last action.
    problem
        Reason for which a change could not be tried out.
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
        address=f"/timeline?{query.write()}",
        start=format_start(view),
        tried=describe_change(view.change, query),
        describe_shift=describe_shift,
    )


def format_start(view: TimelineView) -> str:
    """Write the start that is tried out with its date, so that it means the same later; empty for none."""
    if view.change is None or view.change.not_before_s is None:
        return ""
    return datetime.fromtimestamp(view.change.not_before_s, ZoneInfo(view.zone)).isoformat(" ", "minutes")


def describe_change(change: Change | None, query: TimelineQuery) -> str:
    """Describe the change that is tried out, in a few words."""
    if change is None:
        return ""
    place = f"{dict(MOVES)[query.to]} in the queue" if query.to else ""
    start = f"starting not before {query.at}" if query.at else ""
    return f"job {change.job} {' and '.join(filter(None, (place, start)))}"


def describe_shift(later_s: float | None) -> str:
    """Describe the shift of an end: later or earlier, with the time."""
    if later_s is None:
        return "–"
    if abs(later_s) < 60.0:
        return "the same"
    return f"{format_duration(abs(later_s))} {'later' if later_s > 0 else 'earlier'}"
