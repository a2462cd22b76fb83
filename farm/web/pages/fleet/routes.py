"""Routes of the pages on the fleet's timeline, on printers and on the history."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from drivers.messages import WireLine
from farm import api
from farm.control import find_successor
from farm.errors import ErrorCode, FarmError, NoSuchThing, Refused
from farm.http import Services, find_stored_file
from farm.scheduling import parse_moment_s
from farm.views import ViewContext
from farm.views.dashboard import (
    Change,
    describe_fleet_timeline,
    describe_history,
    describe_printer_page,
    select_prints,
    write_csv,
)
from farm.views.history import describe_ended_print
from farm.views.queue import list_queue
from farm.web.callers import find_holder
from farm.web.notes import Note, Notes, Reader
from farm.web.pages.fleet.history import HistoryQuery, render_history
from farm.web.pages.fleet.printer import render_printer, render_wire
from farm.web.pages.fleet.timeline import TimelineQuery, render_timeline
from farm.web.pages.page_route import PageRoute

_MAX_UPKEEP = 15
_IMAGES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}


def fleet_routes(services: Services, notes: Notes) -> APIRouter:
    """Return the routes of these pages. Long work on the books is done beside the loop, on a copy.

    Parameters
    ----------
    services
        Components of the daemon.
    notes
        Notes to show above the pages.
    """
    router, controller = APIRouter(route_class=PageRoute, include_in_schema=False), services.controller
    fleet = controller.fleet.fleet

    def read(request: Request) -> tuple[ViewContext, Reader, Note | None]:
        holder = find_holder(request)
        context = controller.build_view_context(services.state)
        return context, Reader.for_holder(holder), notes.take(holder.key.id)

    @router.get("/timeline")
    async def show_timeline(request: Request, query: Annotated[TimelineQuery, Query()]) -> Response:
        context, reader, note = read(request)
        situation, problem, change = controller.expected_situation(), None, None
        try:
            change = find_change(context, query)
            view = await asyncio.to_thread(describe_fleet_timeline, context, situation, query.back_s, change)
        except FarmError as error:
            problem = str(error)
            view = await asyncio.to_thread(describe_fleet_timeline, context, situation, query.back_s)
        return HTMLResponse(render_timeline(view, query, fleet.name, reader, note, problem))

    @router.get("/history")
    async def show_history(request: Request, query: Annotated[HistoryQuery, Query()]) -> Response:
        context, reader, note = read(request)
        view = await asyncio.to_thread(describe_history, context, query.to_filter())
        return HTMLResponse(render_history(view, fleet.name, reader, note))

    @router.get("/history.csv")
    async def export_history(request: Request, query: Annotated[HistoryQuery, Query()]) -> Response:
        context, _, _ = read(request)
        text = await asyncio.to_thread(_export, context, query)
        headers = {"content-disposition": f'attachment; filename="{fleet.name}-prints.csv"'}
        return Response(text, media_type="text/csv; charset=utf-8", headers=headers)

    _add_printer_pages(router, services, read)
    return router


def _add_printer_pages(
    router: APIRouter, services: Services, read: Callable[[Request], tuple[ViewContext, Reader, Note | None]]
) -> None:
    """Add the routes of printers: the page, its last lines on the wire, and stills of prints."""
    controller = services.controller
    fleet = controller.fleet.fleet

    @router.get("/printers/{name}")
    async def show_printer(request: Request, name: str) -> Response:
        context, reader, note = read(request)
        printer = controller.fleet_printer(name)
        page = describe_printer_page(
            context,
            name,
            controller.telemetry.list_temperatures(name, context.now_s),
            services.streams.log.read_upkeep(name, _MAX_UPKEEP),
            None if printer is None else printer.obstacle(),
            controller.list_reservations().get(name),
        )
        return HTMLResponse(render_printer(page, fleet.name, fleet.timezone, reader, note))

    @router.get("/printers/{name}/wire")
    async def show_wire(request: Request, name: str) -> Response:
        reader, problem, lines = Reader.for_holder(find_holder(request)), None, list[WireLine]()
        controller.books.printer(name)
        try:
            lines = await services.read_lines(name)
        except Refused as error:
            problem = str(error)
        return HTMLResponse(render_wire(name, lines, fleet.name, controller.fleet.zone, reader, problem))

    @router.get("/jobs/{number}/stills/{name}")
    async def show_still(number: int, name: str) -> Response:
        media_type = _IMAGES.get(Path(name).suffix)
        if media_type is None:
            raise NoSuchThing(f"{name!r} is no picture")
        return FileResponse(await find_stored_file(services, number, name), media_type=media_type)


def find_change(context: ViewContext, query: TimelineQuery) -> Change | None:
    """Return the change to a job that a reader wants to try out; None for the plan as it is.

    Raises
    ------
    NoSuchThing
        If there is no such job.
    Refused
        If it cannot be moved there.
    FarmError
        If the start cannot be read.
    """
    query.check()
    if query.job is None:
        return None
    context.books.job(query.job)
    before, not_before_s = None, None
    if query.to is not None:
        order = [job.id for job in list_queue(context.books)]
        if query.job not in order:
            raise Refused(f"nothing of job {query.job} waits: all of its plates have started")
        before = find_successor(order, query.job, api.QueueMove(to=query.to))
    if query.at:
        try:
            not_before_s = parse_moment_s(query.at, context.now_s, context.fleet.zone)
        except ValueError as error:
            raise FarmError(str(error), ErrorCode.SETTINGS) from error
    return Change(query.job, query.to is not None, before, not_before_s)


def _export(context: ViewContext, query: HistoryQuery) -> str:
    prints = select_prints(context, query.to_filter())
    return write_csv(describe_ended_print(context, one) for one in prints)
