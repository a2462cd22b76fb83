"""Page of a printer: state, temperatures, prints and faults, and its last lines on the wire. Pure."""

from __future__ import annotations

from farm.views.dashboard import PrinterPage
from farm.web.notes import Note, Reader
from farm.web.pages.rendering import render_page


def render_printer(page: PrinterPage, farm: str, zone: str, reader: Reader, note: Note | None = None) -> str:
    """Render the page of a printer.

    Parameters
    ----------
    page
        The printer.
    farm, zone
        Name and time zone of the fleet.
    reader
        Person who reads it; it has the forms that their role allows.
    note
        Message about the reader's last action.
    """
    path = f"/printers/{page.printer.name}"
    return render_page("printer.html", farm, path, reader, note, page=page, zone=zone)
