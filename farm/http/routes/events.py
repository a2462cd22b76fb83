"""Route of the event log, as server-sent events."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse

from farm import api
from farm.errors import RefusedError
from farm.http.callers import CallerName
from farm.http.services import Services
from farm.http.stream_limit import STREAM_TYPE, StreamResponse
from farm.state.event_rows import EventRow
from farm.views import describe_event

_MAX_EVENT_NUMBER = 2**63 - 1  # largest integer of SQLite
_RETRY_FIELD = "retry: 5000\n\n"  # milliseconds after which a browser reconnects
_HEARTBEAT = ":\n\n"
_RESPONSES: dict[int | str, dict[str, object]] = {
    200: {"content": {STREAM_TYPE: {"schema": {"type": "string"}}}}
}


def make_event_routes(services: Services) -> APIRouter:
    """Return the route of the event log."""
    router, controller, streams = APIRouter(), services.controller, services.streams

    def format_rows(rows: Sequence[EventRow]) -> str:
        books, zone = controller.books, controller.fleet.zone
        return "".join(_format_event(describe_event(books, zone, row)) for row in rows) or _HEARTBEAT

    @router.get(
        "/events",
        response_class=StreamingResponse,
        responses=_RESPONSES,
    )
    async def send_events(
        request: Request,
        caller_name: CallerName,
        since: Annotated[int, Query(ge=0, le=_MAX_EVENT_NUMBER)] | None = None,
        wait: bool = True,
        last_event_id: Annotated[int | None, Header(ge=0, le=_MAX_EVENT_NUMBER)] = None,
    ) -> StreamingResponse:
        """Send the events after a given number, and new ones as they happen; without a number, only new ones.

        Each event is an EventView as JSON, with its number as the id. The stream ends when the daemon ends,
        or when the key is revoked; with `wait=false`, it ends after the last event.
        """
        last_number = streams.log.find_last_event_number()
        after = next((number for number in (last_event_id, since) if number is not None), last_number)
        if after > last_number:
            raise RefusedError(
                f"the last event is {last_number}: the database was restored; begin with since={last_number}"
            )
        is_allowed: Callable[[], bool] = getattr(request.state, "is_allowed", lambda: True)
        streams.check_caller(caller_name)

        async def stream_events() -> AsyncIterator[str]:
            yield _RETRY_FIELD
            async for rows in streams.follow(after, is_allowed, wait):
                yield format_rows(rows)

        return StreamResponse(stream_events(), streams.count_stream(caller_name))

    return router


def _format_event(event: api.EventView) -> str:
    return f"id: {event.number}\ndata: {event.model_dump_json()}\n\n"
