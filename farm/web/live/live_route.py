"""Route of the stream that updates a live page."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import StreamingResponse

from farm.http import StreamLimit, StreamResponse
from farm.web.callers import find_holder
from farm.web.live.live_pages import LivePages

_MAX_LENGTH = 300


def make_live_routes(pages: LivePages, streams: StreamLimit) -> APIRouter:
    """Return the route of the stream of changes."""
    router = APIRouter(include_in_schema=False)

    @router.get("/live", response_class=StreamingResponse)
    async def send_changes(
        request: Request,
        page: Annotated[str, Query(max_length=_MAX_LENGTH)] = "/",
        version: Annotated[str, Query(max_length=_MAX_LENGTH)] = "",
    ) -> StreamingResponse:
        """Send the changed elements of a page as JSON by their ids, and heartbeats between changes."""
        holder = find_holder(request)
        streams.check_caller(holder.name)
        await pages.find_topic(page, holder.role)  # raises an error before the stream begins
        changes = pages.follow(page, holder.role, version, request.state.is_allowed)
        return StreamResponse(changes, streams.count_stream(holder.name))

    return router
