"""Routes of the page of a printer, of its last lines on the wire, and of stills of prints."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from drivers.messages import WireLine
from farm.errors import NoSuchThing, Refused
from farm.http import Services, find_stored_file
from farm.views.dashboard import describe_printer_page
from farm.web.callers import find_holder
from farm.web.live import LivePages, publish_page
from farm.web.notes import Note, Notes, Reader
from farm.web.pages.fleet.printer import render_printer, render_wire
from farm.web.pages.page_route import PageRoute

_MAX_UPKEEP = 15
_IMAGES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}


def printer_routes(services: Services, notes: Notes, live: LivePages) -> APIRouter:
    """Return the routes.

    Parameters
    ----------
    services
        Components of the daemon.
    notes
        Notes to show above the pages.
    live
        Receives the page, to keep it up to date.
    """
    router, controller = APIRouter(route_class=PageRoute, include_in_schema=False), services.controller
    fleet = controller.fleet.fleet

    def render_printer_page(reader: Reader, name: str, note: Note | None = None) -> str:
        context, printer = controller.build_view_context(services.state), controller.fleet_printer(name)
        page = describe_printer_page(
            context,
            name,
            controller.telemetry.list_temperatures(name, context.now_s),
            services.streams.log.read_upkeep(name, _MAX_UPKEEP),
            None if printer is None else printer.obstacle(),
            controller.list_reservations().get(name),
        )
        return render_printer(page, fleet.name, fleet.timezone, reader, note)

    async def show_live(reader: Reader, name: str, _query: str) -> str:
        return render_printer_page(reader, name)

    live.add("/printers/{name}", show_live)

    @router.get("/printers/{name}")
    async def show_printer(request: Request, name: str) -> Response:
        holder = find_holder(request)
        with notes.show(holder.key.id) as note:
            return HTMLResponse(publish_page(render_printer_page(Reader.for_holder(holder), name, note)))

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

    return router
