"""Page of a printer: state, temperatures, prints and faults, and its last lines on the wire. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from zoneinfo import ZoneInfo

from drivers.messages import WireLine
from drivers.printers import PROFILES
from farm.views.dashboard import PrinterPage
from farm.web.notes import Note, Reader
from farm.web.pages.home import is_hot
from farm.web.pages.rendering import Farm, render_page

UPKEEP_WORDS = {
    "MaintenanceStarted": "taken out of use",
    "MaintenanceEnded": "back in use",
    "ReelLoaded": "reel loaded",
    "PrinterLost": "connection lost",
    "PrinterAlarmed": "alarm",
    "BedBecameUnknown": "bed unknown",
}
"""Words for the kinds of events about the upkeep of a printer."""


def render_printer(page: PrinterPage, farm: Farm, reader: Reader, note: Note | None = None) -> str:
    """Render the page of a printer.

    Parameters
    ----------
    page
        The printer.
    farm
        The fleet.
    reader
        Person who reads the page; it has the forms that the reader's role allows.
    note
        Message about the reader's last action.
    """
    path = f"/printers/{page.printer.name}"
    title = PROFILES[page.model].title if page.model in PROFILES else page.model
    values = {"page": page, "title": title, "upkeep_words": UPKEEP_WORDS, "is_hot": is_hot(page.printer)}
    return render_page("printer.html", farm, path, reader, note, **values)


@dataclass(frozen=True, slots=True)
class ShownLine:
    """Line on the wire, with its time of day on the farm's clock."""

    at: str
    sent: bool
    text: str


def render_wire(
    name: str,
    lines: Sequence[WireLine],
    farm: Farm,
    reader: Reader,
    problem: str | None = None,
) -> str:
    """Render the last lines on the wire of a printer.

    Parameters
    ----------
    name
        The printer.
    lines
        Lines, oldest first, with times on the farm's clock.
    farm
        The fleet.
    reader
        Person who reads the page.
    problem
        Reason why there are no lines.
    """
    zone = ZoneInfo(farm.timezone)
    shown_lines = [
        ShownLine(f"{datetime.fromtimestamp(line.at_s, zone):%H:%M:%S.%f}"[:-3], line.sent, line.text)
        for line in lines
    ]
    path = f"/printers/{name}/wire"
    return render_page("wire.html", farm, path, reader, name=name, lines=shown_lines, problem=problem)
