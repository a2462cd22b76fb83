"""Error responses for slicers: one line of plain text that begins with the reason.

PrusaSlicer and its forks show the whole body. Cura's plugin shows the first 100 characters if the content
type is exactly `text/plain`. The status 409 is not used, because the plugin treats it differently.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Coroutine
from typing import Any

from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from farm.errors import ErrorCode, FarmError
from farm.text import describe_first_error, flatten_text

log = logging.getLogger(__name__)

_STATUS_CODES = {ErrorCode.NO_SUCH_THING: 404, ErrorCode.FAILED: 500, ErrorCode.ENGINE: 500}
_BAD_REQUEST = 400
_TEXT_TYPE = "text/plain"  # no charset, because Cura's plugin does not show text with one


def make_text_response(text: str, status: int) -> Response:
    """Make a response with one line of plain text."""
    return Response(flatten_text(text).encode(), status, {"content-type": _TEXT_TYPE})


class TextErrorRoute(APIRoute):
    """Route whose errors are plain text."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()

        async def answer_request(request: Request) -> Response:
            try:
                return await handle(request)
            except Exception as error:
                return make_error_response(error)

        return answer_request


def make_error_response(error: Exception) -> Response:
    """Make the response to a request that failed."""
    if isinstance(error, FarmError):
        return make_text_response(str(error), _STATUS_CODES.get(error.code, _BAD_REQUEST))
    if isinstance(error, RequestValidationError):
        return make_text_response(describe_first_error(error.errors()), _BAD_REQUEST)
    if isinstance(error, HTTPException):
        return make_text_response(str(error.detail), error.status_code)
    if isinstance(error, OSError):
        log.warning("a slicer's request failed", exc_info=error)
        text = f"the farm cannot store the file ({error.strerror or error}): check its disk space"
        return make_text_response(text, 500)
    log.error("a slicer's request failed", exc_info=error)
    return make_text_response(f"the daemon failed: {type(error).__name__}; see its log", 500)
