"""Limit on the bodies of requests: a body without end would be kept in memory whole."""

from __future__ import annotations

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LARGEST_BODY_BYTES = 64 * 1024
"""Of a request in JSON; an upload goes to the disk as it comes, and has limits of its own."""
TOO_LARGE = 413


class BodyLimit:
    """Application whose requests have no larger bodies than that; one that goes on is read no further.

    Parameters
    ----------
    app
        The application.
    upload_path
        Where models are sent to.
    """

    def __init__(self, app: ASGIApp, upload_path: str) -> None:
        self._app, self._upload_path = app, upload_path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["path"] == self._upload_path:
            await self._app(scope, receive, send)
            return
        received = 0

        async def receive_limited() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > LARGEST_BODY_BYTES:
                raise HTTPException(TOO_LARGE)
            return message

        await self._app(scope, receive_limited, send)
