"""Size limit for request bodies, which are held in memory."""

from __future__ import annotations

from collections.abc import Callable

from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_BODY_BYTES = 64 * 1024
"""Limit on a JSON body; an upload is written to the disk chunk by chunk, and has its own limits."""
TOO_LARGE_STATUS = 413
_MIN_ERROR_STATUS = 400  # lowest status code of an error


class BodyLimit:
    """Middleware that rejects bodies over the limit; an error before the end of a body closes the connection.

    Parameters
    ----------
    app
        The application.
    is_upload
        Function that returns whether a path receives uploads, which are exempt.
    """

    def __init__(self, app: ASGIApp, is_upload: Callable[[str], bool]) -> None:
        self._app, self._is_upload = app, is_upload

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        is_limited = not self._is_upload(scope["path"])
        received_bytes, is_complete = 0, False

        async def receive_with_limit() -> Message:
            nonlocal received_bytes, is_complete
            message = await receive()
            received_bytes += len(message.get("body", b""))
            is_complete = not message.get("more_body", False)
            if is_limited and received_bytes > MAX_BODY_BYTES:
                raise HTTPException(TOO_LARGE_STATUS)
            return message

        async def send_with_close_header(message: Message) -> None:
            if (
                message["type"] == "http.response.start"
                and message["status"] >= _MIN_ERROR_STATUS
                and not is_complete
            ):
                # Otherwise the server would read the rest of the body.
                MutableHeaders(scope=message)["connection"] = "close"
            await send(message)

        await self._app(scope, receive_with_limit, send_with_close_header)
