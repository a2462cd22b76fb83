"""Limit on the number of open streams (server-sent events). All streams end when the daemon ends."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress

from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from farm.errors import RefusedError

STREAM_TYPE = "text/event-stream"
_HEADERS = {"x-accel-buffering": "no"}  # tells a proxy not to buffer events


class StreamLimit:
    """Counter and limit of open streams; `close` ends all of them.

    Parameters
    ----------
    limit
        Maximum number of streams at a time.
    limit_per_caller
        Maximum number of streams of one caller.
    """

    def __init__(self, limit: int = 100, limit_per_caller: int = 20) -> None:
        self._limit, self._limit_per_caller = limit, limit_per_caller
        self._counts_by_caller: Counter[str] = Counter()
        self._close_event = asyncio.Event()

    def close(self) -> None:
        """End all streams."""
        self._close_event.set()

    @property
    def is_closed(self) -> bool:
        """True once all streams must end."""
        return self._close_event.is_set()

    async def wait(self, duration_s: float) -> None:
        """Wait for a duration in seconds, or until the streams are closed."""
        with suppress(TimeoutError):
            async with asyncio.timeout(duration_s):
                await self._close_event.wait()

    def check_caller(self, caller: str) -> None:
        """Raise RefusedError if a caller may not open another stream."""
        if self.is_closed:
            raise RefusedError("the daemon is shutting down: open the stream after `farm up`")
        if (
            self._counts_by_caller.total() >= self._limit
            or self._counts_by_caller[caller] >= self._limit_per_caller
        ):
            raise RefusedError(
                f"too many streams are open ({self._counts_by_caller[caller]} of {caller}): end one"
            )

    @contextmanager
    def count_stream(self, caller: str) -> Iterator[None]:
        """Count a stream of a caller while it is open."""
        self._counts_by_caller[caller] += 1
        try:
            yield
        finally:
            self._counts_by_caller[caller] -= 1


class StreamResponse(StreamingResponse):
    """Server-sent events, counted as an open stream until they end or the client disconnects."""

    def __init__(
        self, content: AsyncIterator[str] | AsyncIterator[bytes], permit: AbstractContextManager[None]
    ) -> None:
        super().__init__(content, media_type=STREAM_TYPE, headers=_HEADERS)
        self._permit = permit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._permit:
            await super().__call__(scope, receive, send)
