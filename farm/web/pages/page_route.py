"""Routes of pages: an error is shown as a page, in its words."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse
from fastapi.routing import APIRoute
from pydantic import BeforeValidator

from farm.errors import FarmError, NoSuchThing
from farm.text import describe_first_error
from farm.web.pages.rendering import render_message

_NOT_FOUND, _BAD_REQUEST = 404, 400
EMPTY_IS_NONE = BeforeValidator(lambda value: None if value == "" else value)
"""Reads a field of a form that was left empty as if it were missing."""


class PageRoute(APIRoute):
    """Route of a page. A farm's error, or an address that cannot be read, becomes a page with the message."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of requests."""
        handle = super().get_route_handler()

        async def answer(request: Request) -> Response:
            try:
                return await handle(request)
            except FarmError as error:
                text, status = str(error), _NOT_FOUND if isinstance(error, NoSuchThing) else _BAD_REQUEST
            except RequestValidationError as error:
                text, status = describe_first_error(error.errors()), _BAD_REQUEST
            return HTMLResponse(render_message(request.app.state.controller.fleet.fleet.name, text), status)

        return answer
