"""History page: a filter, and figures of the prints that have ended; the same prints as a CSV file."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from farm.views import ViewContext
from farm.views.dashboard import HistoryFilter, HistoryView, describe_history, select_prints, write_csv
from farm.views.history import make_history_row
from farm.web.notes import Note, User
from farm.web.pages.page_context import SLOW_PAGE_ROUNDS, PageContext
from farm.web.pages.page_route import EMPTY_FIELD_VALIDATOR, PageRoute, read_query
from farm.web.pages.rendering import FleetInfo, render_page

PERIODS = ((None, "all"), (1, "last day"), (7, "last 7 days"), (30, "last 30 days"), (365, "last year"))
"""Periods to choose from, each as a number of days and a label."""


class HistoryQuery(BaseModel):
    """Filter of prints in the page's URL; an empty field matches all prints."""

    days: Annotated[Annotated[int, Field(ge=1, le=36_500)] | None, EMPTY_FIELD_VALIDATOR] = None
    printer: Annotated[Annotated[str, Field(max_length=100)] | None, EMPTY_FIELD_VALIDATOR] = None
    job: Annotated[Annotated[int, Field(ge=1, le=2**31)] | None, EMPTY_FIELD_VALIDATOR] = None

    def to_filter(self) -> HistoryFilter:
        """Return the filter as a parameter of `describe_history`."""
        return HistoryFilter(days=self.days, printer=self.printer, job=self.job)


def make_history_routes(pages: PageContext) -> APIRouter:
    """Return the routes of the history.

    The books are read in a thread, because a long history would block the event loop.
    """
    router, services = APIRouter(route_class=PageRoute, include_in_schema=False), pages.services
    controller = services.controller
    fleet = controller.fleet.fleet

    async def render(user: User, query: HistoryQuery, note: Note | None = None) -> str:
        context = controller.build_view_context(services.state)
        view = await asyncio.to_thread(describe_history, context, query.to_filter())
        return render_history(view, fleet, user, note)

    async def render_live(user: User, _variable: str, query: str) -> str:
        return await render(user, read_query(HistoryQuery, query))

    pages.live_pages.add("/history", render_live, SLOW_PAGE_ROUNDS)

    @router.get("/history")
    async def show_history(request: Request, query: Annotated[HistoryQuery, Query()]) -> Response:
        return await pages.answer(request, lambda user, note: render(user, query, note))

    @router.get("/history.csv")
    async def export_history(query: Annotated[HistoryQuery, Query()]) -> Response:
        text = await asyncio.to_thread(_format_csv, controller.build_view_context(services.state), query)
        headers = {"content-disposition": f'attachment; filename="{fleet.name}-prints.csv"'}
        return Response(text, media_type="text/csv; charset=utf-8", headers=headers)

    return router


def render_history(view: HistoryView, fleet: FleetInfo, user: User, note: Note | None = None) -> str:
    """Render the page.

    Parameters
    ----------
    view
        Prints that have ended, with figures.
    fleet
        The fleet.
    user
        User of the page.
    note
        Message about the user's last action.
    """
    values = asdict(view.history_filter)
    query = urlencode({name: value for name, value in values.items() if value is not None})
    return render_page(
        "history.html",
        fleet,
        "/history",
        user,
        note,
        view=view,
        periods=PERIODS,
        query=f"?{query}" if query else "",
    )


def _format_csv(context: ViewContext, query: HistoryQuery) -> str:
    prints = select_prints(context, query.to_filter())
    return write_csv(make_history_row(context, attempt) for attempt in prints)
