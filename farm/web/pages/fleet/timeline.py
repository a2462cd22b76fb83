"""Page with the timeline of the fleet, and with the effect of a what-if change to a job."""

from __future__ import annotations

import asyncio
from datetime import datetime
from typing import Annotated, Literal
from urllib.parse import urlencode
from zoneinfo import ZoneInfo

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from farm import api
from farm.control import find_successor
from farm.errors import ErrorCode, FarmError, RefusedError
from farm.scheduling import parse_moment_s
from farm.text import format_duration
from farm.views import ViewContext
from farm.views.dashboard import Change, TimelineView, describe_fleet_timeline
from farm.views.jobs import count_waiting_plates, list_queue
from farm.web.notes import Note, User
from farm.web.pages.page_context import SLOW_PAGE_ROUNDS, PageContext
from farm.web.pages.page_route import EMPTY_FIELD_VALIDATOR, PageRoute, read_query
from farm.web.pages.rendering import FleetInfo, render_page

PERIODS = ((6, "6 hours"), (12, "12 hours"), (24, "day"), (72, "3 days"), (168, "week"))
"""Periods before the present that the page can show, each as a number of hours and a label."""
MOVES = (("", "unchanged"), ("first", "first"), ("up", "one up"), ("down", "one down"), ("last", "last"))
"""What-if moves of a job, each as a value of `api.QueuePlace` and a label."""


class TimelineQuery(BaseModel):
    """Query of the page: the length of the past period that it shows, and a what-if change."""

    hours: Literal["6", "12", "24", "72", "168"] = "12"
    job: Annotated[Annotated[int, Field(ge=1, le=2**31)] | None, EMPTY_FIELD_VALIDATOR] = None
    to: Annotated[api.QueuePlace | None, EMPTY_FIELD_VALIDATOR] = None
    at: Annotated[str, Field(max_length=40)] = ""

    @property
    def past_s(self) -> float:
        """Length of the past period that the page shows, in seconds."""
        return int(self.hours) * 3600.0

    def format_query(self) -> str:
        """Format the query for a URL."""
        return urlencode(self.model_dump(exclude_defaults=True))

    def check(self) -> None:
        """Raise RefusedError if a job is named without a change, or a change without a job."""
        if self.job is None and (self.to or self.at):
            raise RefusedError("choose a job")
        if self.job is not None and not (self.to or self.at):
            raise RefusedError("choose another place in the queue, or another start")


def make_timeline_routes(pages: PageContext) -> APIRouter:
    """Return the route of the timeline.

    The books are read in a thread, because a long history would block the event loop.
    """
    router, services = APIRouter(route_class=PageRoute, include_in_schema=False), pages.services
    controller = services.controller

    async def render(user: User, query: TimelineQuery, note: Note | None = None) -> str:
        context, situation = (
            controller.build_view_context(services.state),
            controller.situations.build_for_forecast(),
        )
        problem, change = None, None
        try:
            change = find_change(context, query)
            view = await asyncio.to_thread(describe_fleet_timeline, context, situation, query.past_s, change)
        except FarmError as error:
            problem = str(error)
            view = await asyncio.to_thread(describe_fleet_timeline, context, situation, query.past_s)
        return render_timeline(view, query, controller.fleet.fleet, user, note, problem)

    async def render_live(user: User, _variable: str, query: str) -> str:
        return await render(user, read_query(TimelineQuery, query))

    pages.live_pages.add("/timeline", render_live, SLOW_PAGE_ROUNDS)

    @router.get("/timeline")
    async def show_timeline(request: Request, query: Annotated[TimelineQuery, Query()]) -> Response:
        return await pages.answer(request, lambda user, note: render(user, query, note))

    return router


def find_change(context: ViewContext, query: TimelineQuery) -> Change | None:
    """Return the what-if change that a user has chosen for a job; None if there is none.

    Raises
    ------
    NotFoundError
        If there is no such job.
    RefusedError
        If no plate of the job is waiting, or the job cannot be moved to the chosen place.
    FarmError
        If the start cannot be parsed.
    """
    query.check()
    if query.job is None:
        return None
    job = context.books.get_job(query.job)
    if not count_waiting_plates(context.books, job):
        reason = "all of its plates have started" if job.plates else "it has no plan yet"
        raise RefusedError(f"job {job.id} has no plate to move: {reason}")
    before, not_before_s = None, None
    if query.to is not None:
        order = [entry.id for entry in list_queue(context.books)]
        before = find_successor(order, job.id, api.QueueMove(to=query.to))
    if query.at:
        try:
            not_before_s = parse_moment_s(query.at, context.now_s, context.fleet.zone)
        except ValueError as error:
            raise FarmError(str(error), ErrorCode.SETTINGS) from error
    return Change(job.id, query.to is not None, before, not_before_s)


def render_timeline(
    view: TimelineView,
    query: TimelineQuery,
    fleet: FleetInfo,
    user: User,
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
    fleet
        The fleet.
    user
        User of the page.
    note
        Message about the user's last action.
    problem
        Reason why the what-if change is not possible; None if it is possible, or if no change was chosen.
    """
    return render_page(
        "timeline.html",
        fleet,
        "/timeline",
        user,
        note,
        view=view,
        problem=problem,
        periods=PERIODS,
        moves=MOVES,
        move=query.to or "",
        at=query.at,
        page_url=f"/timeline?{query.format_query()}",
        start=format_start(view),
        change_text=describe_change(view.change, query),
        describe_delay=describe_delay,
    )


def format_start(view: TimelineView) -> str:
    """Format the start in a what-if change with its date; return an empty text if there is none.

    Without the date, `22:00` would mean another day if the form is sent tomorrow.
    """
    if view.change is None or view.change.not_before_s is None:
        return ""
    return datetime.fromtimestamp(view.change.not_before_s, ZoneInfo(view.zone)).isoformat(" ", "minutes")


def describe_change(change: Change | None, query: TimelineQuery) -> str:
    """Describe a what-if change in a few words."""
    if change is None:
        return ""
    place = f"{dict(MOVES)[query.to]} in the queue" if query.to else ""
    start = f"starting no earlier than {query.at}" if query.at else ""
    return f"job {change.job} {' and '.join(filter(None, (place, start)))}"


def describe_delay(delay_s: float | None) -> str:
    """Describe how much later or earlier a job ends."""
    if delay_s is None:
        return "–"
    if abs(delay_s) < 60.0:
        return "the same"
    return f"{format_duration(abs(delay_s))} {'later' if delay_s > 0 else 'earlier'}"
