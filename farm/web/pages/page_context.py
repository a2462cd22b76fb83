"""Objects that the routes of pages share, and the response to a request for a page."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from fastapi import Request, Response
from fastapi.responses import HTMLResponse

from farm.http import Services
from farm.web.callers import find_holder
from farm.web.live import LivePages, prepare_page
from farm.web.notes import Note, Notes, User

SLOW_PAGE_ROUNDS = 10
"""Number of rounds of live pages between two renderings of a page that reads all jobs and prints."""
PageRenderer = Callable[[User, Note | None], Awaitable[str]]
"""Function that renders a page for a user, with a note at its top."""


@dataclass(frozen=True, slots=True)
class PageContext:
    """Objects that the routes of pages share.

    Attributes
    ----------
    services
        Components of the daemon.
    notes
        Notes that the pages show to users.
    live_pages
        Registry of the live pages.
    """

    services: Services
    notes: Notes
    live_pages: LivePages

    async def answer(self, request: Request, render: PageRenderer) -> Response:
        """Return a page with the caller's note as the response; the note is kept if rendering fails."""
        holder = find_holder(request)
        with self.notes.show(holder.key.id) as note:
            return HTMLResponse(prepare_page(await render(User.for_holder(holder), note)))
