"""Pages of a printer, and stills of prints.

A printer has a page with its state, temperatures, prints and faults, and a page with the last lines on the
wire: those that its agent and its board have exchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from drivers.messages import WireLine
from drivers.printers import PROFILES
from farm.errors import NotFoundError, RefusedError
from farm.http import find_stored_file
from farm.views.dashboard import PrinterPage, describe_printer_page
from farm.web.callers import find_holder
from farm.web.notes import Note, User
from farm.web.pages.home import is_hot
from farm.web.pages.page_context import PageContext
from farm.web.pages.page_route import PageRoute
from farm.web.pages.rendering import FleetInfo, render_page

UPKEEP_WORDS = {
    "MaintenanceStarted": "taken out of use",
    "MaintenanceEnded": "back in use",
    "ReelLoaded": "reel loaded",
    "PrinterLost": "connection lost",
    "PrinterAlarmed": "alarm",
    "BedBecameUnknown": "bed unknown",
}
"""Texts for the kinds of events in the section "Upkeep" of a printer's page."""
_MAX_UPKEEP_EVENTS = 15
_IMAGE_TYPES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}


def make_printer_page_routes(pages: PageContext) -> APIRouter:
    """Return the routes of a printer's pages and of stills."""
    router, services = APIRouter(route_class=PageRoute, include_in_schema=False), pages.services
    controller = services.controller
    fleet = controller.fleet.fleet

    async def render(user: User, name: str, note: Note | None = None) -> str:
        context, printer = (
            controller.build_view_context(services.state),
            controller.situations.describe_printer(name),
        )
        page = describe_printer_page(
            context,
            name,
            controller.telemetry.list_temperatures(name, context.now_s),
            services.streams.log.read_printer_events(name, _MAX_UPKEEP_EVENTS),
            None if printer is None else printer.find_obstacle(),
            controller.scheduler.list_reservations().get(name),
        )
        return render_printer(page, fleet, user, note)

    pages.live_pages.add("/printers/{name}", lambda user, name, _query: render(user, name))

    @router.get("/printers/{name}")
    async def show_printer(request: Request, name: str) -> Response:
        return await pages.answer(request, lambda user, note: render(user, name, note))

    @router.get("/printers/{name}/wire")
    async def show_wire(request: Request, name: str) -> Response:
        user, problem, lines = User.for_holder(find_holder(request)), None, list[WireLine]()
        controller.books.get_printer(name)
        try:
            lines = await services.read_lines(name)
        except RefusedError as error:
            problem = str(error)
        return HTMLResponse(render_wire(name, lines, fleet, user, problem))

    @router.get("/jobs/{number}/stills/{name}")
    async def show_still(number: int, name: str) -> Response:
        media_type = _IMAGE_TYPES.get(Path(name).suffix)
        if media_type is None:
            raise NotFoundError(f"{name!r} is not a picture")
        return FileResponse(await find_stored_file(services, number, name), media_type=media_type)

    return router


def render_printer(page: PrinterPage, fleet: FleetInfo, user: User, note: Note | None = None) -> str:
    """Render the page of a printer.

    Parameters
    ----------
    page
        Data of the printer.
    fleet
        The fleet.
    user
        User of the page, whose role decides which forms it has.
    note
        Message about the user's last action.
    """
    path = f"/printers/{page.printer.name}"
    title = PROFILES[page.model].title if page.model in PROFILES else page.model
    values = {"page": page, "title": title, "upkeep_words": UPKEEP_WORDS, "is_hot": is_hot(page.printer)}
    return render_page("printer.html", fleet, path, user, note, **values)


@dataclass(frozen=True, slots=True)
class ShownLine:
    """Line to or from the board, with its time of day on the farm's clock."""

    time: str
    is_sent: bool
    text: str


def render_wire(
    name: str,
    lines: Sequence[WireLine],
    fleet: FleetInfo,
    user: User,
    problem: str | None = None,
) -> str:
    """Render the page with the last lines between a printer's agent and its board.

    Parameters
    ----------
    name
        Name of the printer.
    lines
        Lines, oldest first, with times on the farm's clock.
    fleet
        The fleet.
    user
        User of the page.
    problem
        Reason why there are no lines.
    """
    zone = ZoneInfo(fleet.timezone)
    shown_lines = [
        ShownLine(f"{datetime.fromtimestamp(line.at_s, zone):%H:%M:%S.%f}"[:-3], line.sent, line.text)
        for line in lines
    ]
    path = f"/printers/{name}/wire"
    return render_page("wire.html", fleet, path, user, name=name, lines=shown_lines, problem=problem)
