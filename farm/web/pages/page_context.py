"""Objects that the routes of pages share, and the answer to a request for a page."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from fastapi import Request, Response
from fastapi.responses import HTMLResponse

from farm.http import Services
from farm.web.callers import find_holder
from farm.web.live import LivePages, publish_page
from farm.web.notes import Note, Notes, Reader

Render = Callable[[Reader, Note | None], Awaitable[str]]
"""Renders a page for a reader, with a note above it."""


@dataclass(frozen=True, slots=True)
class PageContext:
    """Objects that the routes of pages share.

    Attributes
    ----------
    services
        Components of the daemon.
    notes
        Notes to show above the pages.
    live
        Receives the pages that are kept up to date.
    """

    services: Services
    notes: Notes
    live: LivePages

    async def answer(self, request: Request, render: Render) -> Response:
        """Answer with a page for the caller, with the caller's note, which is kept if the page fails."""
        holder = find_holder(request)
        with self.notes.show(holder.key.id) as note:
            return HTMLResponse(publish_page(await render(Reader.for_holder(holder), note)))
