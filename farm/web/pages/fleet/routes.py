"""Routes of the pages of the fleet's timeline and of the history."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from farm import api
from farm.control import find_successor
from farm.errors import ErrorCode, FarmError, Refused
from farm.scheduling import parse_moment_s
from farm.views import ViewContext
from farm.views.dashboard import (
    Change,
    describe_fleet_timeline,
    describe_history,
    select_prints,
    write_csv,
)
from farm.views.history import describe_ended_print
from farm.views.jobs import count_waiting_plates, list_queue
from farm.web.notes import Note, Reader
from farm.web.pages.fleet.history import HistoryQuery, render_history
from farm.web.pages.fleet.timeline import TimelineQuery, render_timeline
from farm.web.pages.page_context import PageContext
from farm.web.pages.page_route import PageRoute, read_query

_ROUNDS = 10  # rounds of live pages between two renderings, because these pages read all jobs and prints


def make_fleet_routes(pages: PageContext) -> APIRouter:
    """Return the routes of the timeline and of the history.

    The books are read in a thread, because a long history would block the event loop.
    """
    router, services = APIRouter(route_class=PageRoute, include_in_schema=False), pages.services
    controller = services.controller
    fleet = controller.fleet.fleet

    async def render_timeline_page(reader: Reader, query: TimelineQuery, note: Note | None = None) -> str:
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
        return render_timeline(view, query, fleet, reader, note, problem)

    async def render_history_page(reader: Reader, query: HistoryQuery, note: Note | None = None) -> str:
        context = controller.build_view_context(services.state)
        view = await asyncio.to_thread(describe_history, context, query.to_filter())
        return render_history(view, fleet, reader, note)

    async def render_live_timeline(reader: Reader, _variable: str, query: str) -> str:
        return await render_timeline_page(reader, read_query(TimelineQuery, query))

    async def render_live_history(reader: Reader, _variable: str, query: str) -> str:
        return await render_history_page(reader, read_query(HistoryQuery, query))

    pages.live.add("/timeline", render_live_timeline, _ROUNDS)
    pages.live.add("/history", render_live_history, _ROUNDS)

    @router.get("/timeline")
    async def show_timeline(request: Request, query: Annotated[TimelineQuery, Query()]) -> Response:
        return await pages.answer(request, lambda reader, note: render_timeline_page(reader, query, note))

    @router.get("/history")
    async def show_history(request: Request, query: Annotated[HistoryQuery, Query()]) -> Response:
        return await pages.answer(request, lambda reader, note: render_history_page(reader, query, note))

    @router.get("/history.csv")
    async def export_history(query: Annotated[HistoryQuery, Query()]) -> Response:
        text = await asyncio.to_thread(_export_history, controller.build_view_context(services.state), query)
        headers = {"content-disposition": f'attachment; filename="{fleet.name}-prints.csv"'}
        return Response(text, media_type="text/csv; charset=utf-8", headers=headers)

    return router


def find_change(context: ViewContext, query: TimelineQuery) -> Change | None:
    """Return the what-if change to a job that a reader has chosen; None for the present plan.

    Raises
    ------
    NoSuchThing
        If there is no such job.
    Refused
        If none of its plates waits, or the job cannot be moved there.
    FarmError
        If the start cannot be parsed.
    """
    query.check()
    if query.job is None:
        return None
    job = context.books.get_job(query.job)
    if not count_waiting_plates(context.books, job):
        reason = "all of its plates have started" if job.plates else "it has no plan yet"
        raise Refused(f"job {job.id} has no plate to move: {reason}")
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


def _export_history(context: ViewContext, query: HistoryQuery) -> str:
    prints = select_prints(context, query.to_filter())
    return write_csv(describe_ended_print(context, attempt) for attempt in prints)
