"""Routes of a printer's page, of its last lines on the wire, and of stills of prints."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from drivers.messages import WireLine
from farm.errors import NoSuchThing, Refused
from farm.http import find_stored_file
from farm.views.dashboard import describe_printer_page
from farm.web.callers import find_holder
from farm.web.notes import Note, Reader
from farm.web.pages.fleet.printer import render_printer, render_wire
from farm.web.pages.page_context import PageContext
from farm.web.pages.page_route import PageRoute

_MAX_UPKEEP = 15
_IMAGES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}


def make_printer_page_routes(pages: PageContext) -> APIRouter:
    """Return the routes of a printer's pages and of stills."""
    router, services = APIRouter(route_class=PageRoute, include_in_schema=False), pages.services
    controller = services.controller
    fleet = controller.fleet.fleet

    async def render(reader: Reader, name: str, note: Note | None = None) -> str:
        context, printer = (
            controller.build_view_context(services.state),
            controller.situations.describe_printer(name),
        )
        page = describe_printer_page(
            context,
            name,
            controller.telemetry.list_temperatures(name, context.now_s),
            services.streams.log.read_upkeep(name, _MAX_UPKEEP),
            None if printer is None else printer.find_obstacle(),
            controller.scheduler.list_reservations().get(name),
        )
        return render_printer(page, fleet, reader, note)

    pages.live.add("/printers/{name}", lambda reader, name, _query: render(reader, name))

    @router.get("/printers/{name}")
    async def show_printer(request: Request, name: str) -> Response:
        return await pages.answer(request, lambda reader, note: render(reader, name, note))

    @router.get("/printers/{name}/wire")
    async def show_wire(request: Request, name: str) -> Response:
        reader, problem, lines = Reader.for_holder(find_holder(request)), None, list[WireLine]()
        controller.books.get_printer(name)
        try:
            lines = await services.read_lines(name)
        except Refused as error:
            problem = str(error)
        return HTMLResponse(render_wire(name, lines, fleet, reader, problem))

    @router.get("/jobs/{number}/stills/{name}")
    async def show_still(number: int, name: str) -> Response:
        media_type = _IMAGES.get(Path(name).suffix)
        if media_type is None:
            raise NoSuchThing(f"{name!r} is not a picture")
        return FileResponse(await find_stored_file(services, number, name), media_type=media_type)

    return router
