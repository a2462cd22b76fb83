"""Compression of pages. Files, streams and the answers to programs are sent as they are."""

from __future__ import annotations

import gzip

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_LEVEL = 5
_SMALL_BYTES = 1000


class PageCompression:
    """Middleware that compresses HTML which is sent in one piece, for clients that read gzip."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        if scope["type"] != "http" or "gzip" not in Headers(scope=scope).get("accept-encoding", ""):
            await self._app(scope, receive, send)
            return
        start: Message | None = None

        async def send_compressed(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start" and _is_page(message):
                start = message
                return
            if start is not None:
                head, start = start, None
                await send(_compress(head, message))
            await send(message)

        await self._app(scope, receive, send_compressed)


def _is_page(message: Message) -> bool:
    headers = Headers(raw=message["headers"])
    return headers.get("content-type", "").startswith("text/html") and "content-encoding" not in headers


def _compress(head: Message, body: Message) -> Message:
    """Compress the body in place if it is whole and long enough; return the head for it."""
    content = body.get("body", b"")
    headers = MutableHeaders(raw=list(head["headers"]))
    headers["vary"] = "accept-encoding"
    if not body.get("more_body", False) and len(content) >= _SMALL_BYTES:
        body["body"] = gzip.compress(content, _LEVEL, mtime=0)
        headers["content-encoding"] = "gzip"
        headers["content-length"] = str(len(body["body"]))
    return {**head, "headers": headers.raw}
