"""Live pages, and the route that streams their changes.

In each round, a page that somebody views is rendered once for each role, and its changes are sent to all
viewers with that role. A round lasts a second, or longer if rendering is slow.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import StreamingResponse

from farm.errors import FarmError, NotFoundError
from farm.http import StreamLimit, StreamResponse
from farm.model import Role
from farm.web.callers import find_holder
from farm.web.live.fragments import MAIN_ID, find_changes, split_page
from farm.web.notes import User

log = logging.getLogger(__name__)

LivePageRenderer = Callable[[User, str, str], Awaitable[str]]
"""Function that renders a page for a user from the variable part of its path and the query of its URL."""

_MIN_ROUND_S = 1.0  # minimum time between two rounds
_MAX_RENDERING_SHARE = 0.05  # share of the daemon's time that rendering may take
_HEARTBEAT_INTERVAL_S = 5.0
_RETRY = b"retry: 3000\n\n"  # milliseconds after which a browser reconnects
_HEARTBEAT = b"event: beat\ndata:\n\n"
_MAX_QUERY_LENGTH = 300


class _Topic:
    """One page for one role: its last rendering, which is renewed every few rounds, and its viewers."""

    def __init__(self, render: Callable[[], Awaitable[str]], page: str, rounds_per_rendering: int) -> None:
        self._render = render
        self._rounds_per_rendering = self._rounds_left = rounds_per_rendering
        self.viewer_count, self.is_over = 0, False
        self.fragments = split_page(page)
        self.version, self._message = self.fragments.version, b""
        self._previous_version: str | None = None
        self._change = asyncio.Event()

    async def refresh(self) -> None:
        """Handle a round: render again if a rendering is due, and after a change wake all viewers."""
        self._rounds_left -= 1
        if self._rounds_left <= 0:
            await self._render_again()

    async def refresh_for_version(self, version: str) -> None:
        """Render again if a viewer's version is unknown, because it may be newer than the last rendering."""
        if self._rounds_per_rendering > 1 and version not in (self.version, self._previous_version):
            await self._render_again()

    async def _render_again(self) -> None:
        self._rounds_left = self._rounds_per_rendering
        fragments = split_page(await self._render())
        changes = find_changes(self.fragments, fragments)
        if changes:
            self._previous_version, self.version, self.fragments = self.version, fragments.version, fragments
            self._message = format_changes(changes, self.version)
            self.wake()

    def wake(self) -> None:
        """Wake the streams of all viewers, which call `wait`."""
        change, self._change = self._change, asyncio.Event()
        change.set()

    async def wait(self, duration_s: float) -> None:
        """Wait for the next change, at most for a duration in seconds."""
        with suppress(TimeoutError):
            async with asyncio.timeout(duration_s):
                await self._change.wait()

    def format_changes_since(self, version: str) -> bytes:
        """Return the changes since a version as an event: none, the last changes, or the whole page."""
        if version == self.version:
            return b""
        if version == self._previous_version:
            return self._message
        return format_changes({MAIN_ID: self.fragments.html}, self.version)


class LivePages:
    """All live pages, by path.

    Parameters
    ----------
    streams
        Counter and limit of open streams. It also ends all of them when the daemon ends.
    """

    def __init__(self, streams: StreamLimit) -> None:
        self._streams = streams
        self._pages: list[tuple[re.Pattern[str], LivePageRenderer, int]] = []
        self._topics: dict[tuple[str, Role], _Topic] = {}
        self._refresh_task: asyncio.Task[None] | None = None

    def add(self, path: str, render: LivePageRenderer, rounds_per_rendering: int = 1) -> None:
        """Add a page.

        Parameters
        ----------
        path
            Path of the page, in which at most one part is variable, such as `/jobs/{number}`.
        render
            Function that renders the page.
        rounds_per_rendering
            Number of rounds from one rendering to the next.
        """
        self._pages.append((re.compile(re.sub(r"\{\w+\}", "([^/]+)", path)), render, rounds_per_rendering))

    async def find_topic(self, page_url: str, role: Role) -> _Topic:
        """Return the topic of a page for a role. Raises FarmError if there is no such page."""
        topic = self._topics.get((page_url, role))
        if topic is not None:
            return topic
        render, rounds_per_rendering = self._find_renderer(page_url, role)
        topic = _Topic(render, await render(), rounds_per_rendering)
        return self._topics.setdefault((page_url, role), topic)

    async def follow(
        self, page_url: str, role: Role, version: str, is_allowed: Callable[[], bool]
    ) -> AsyncIterator[bytes]:
        """Yield the changes of a page as server-sent events, and a heartbeat while there are none.

        Parameters
        ----------
        page_url, role
            Path and query of the page, and the role of its viewer.
        version
            Version of the page in the viewer's browser.
        is_allowed
            Function that returns whether the viewer may still see the page.
        """
        topic = await self.find_topic(page_url, role)
        topic.viewer_count += 1  # before any await, because a round removes topics without viewers
        self._start_refreshing()
        try:
            await topic.refresh_for_version(version)
            yield _RETRY
            while is_allowed() and not self._streams.is_closed and not topic.is_over:
                message = topic.format_changes_since(version)
                version = topic.version
                yield message or _HEARTBEAT
                if version == topic.version and not topic.is_over:  # otherwise the page has just changed
                    await topic.wait(_HEARTBEAT_INTERVAL_S)
        finally:
            topic.viewer_count -= 1

    def _find_renderer(self, page_url: str, role: Role) -> tuple[Callable[[], Awaitable[str]], int]:
        path, _, query = page_url.partition("?")
        for pattern, render, rounds_per_rendering in self._pages:
            match = pattern.fullmatch(path)
            if match is not None:
                return partial(render, User("", role), "".join(match.groups()), query), rounds_per_rendering
        raise NotFoundError(f"there is no live page {path}")

    def _start_refreshing(self) -> None:
        if self._refresh_task is None or self._refresh_task.done():
            self._refresh_task = asyncio.get_running_loop().create_task(self._refresh_pages())

    async def _refresh_pages(self) -> None:
        """Render the pages that have viewers, round after round, until no page has viewers."""
        pause_s = _MIN_ROUND_S
        while self._topics:
            await self._streams.wait(pause_s)
            spent_s = 0.0
            for key, topic in list(self._topics.items()):
                if topic.viewer_count == 0 or self._streams.is_closed:
                    self._end_topic(key)
                else:
                    start_s = time.perf_counter()  # wall time, because a page may be rendered in a thread
                    await self._refresh_topic(key, topic)
                    spent_s += time.perf_counter() - start_s
                await asyncio.sleep(0.0)  # lets other tasks run between two pages
            pause_s = max(_MIN_ROUND_S, spent_s / _MAX_RENDERING_SHARE)

    async def _refresh_topic(self, key: tuple[str, Role], topic: _Topic) -> None:
        try:
            await topic.refresh()
        except Exception as error:
            if not isinstance(error, FarmError):  # expected, for example if the page's job was pruned
                log.exception("cannot render the live page %s", key[0])
            self._end_topic(key)

    def _end_topic(self, key: tuple[str, Role]) -> None:
        """Remove a topic, and end the streams of its viewers."""
        topic = self._topics.pop(key)
        topic.is_over = True
        topic.wake()


def format_changes(changes: dict[str, str], version: str) -> bytes:
    """Format changes as one server-sent event, whose id is the new version."""
    return f"id: {version}\ndata: {json.dumps(changes, ensure_ascii=False)}\n\n".encode()


def make_live_routes(pages: LivePages, streams: StreamLimit) -> APIRouter:
    """Return the route that streams the changes of a page."""
    router = APIRouter(include_in_schema=False)

    @router.get("/live", response_class=StreamingResponse)
    async def send_changes(
        request: Request,
        page: Annotated[str, Query(max_length=_MAX_QUERY_LENGTH)] = "/",
        version: Annotated[str, Query(max_length=_MAX_QUERY_LENGTH)] = "",
    ) -> StreamingResponse:
        """Send JSON objects that map ids of changed elements to their HTML, and heartbeats between them."""
        holder = find_holder(request)
        streams.check_caller(holder.name)
        await pages.find_topic(page, holder.role)  # raises an error before the stream begins
        changes = pages.follow(page, holder.role, version, request.state.is_allowed)
        return StreamResponse(changes, streams.count_stream(holder.name))

    return router
