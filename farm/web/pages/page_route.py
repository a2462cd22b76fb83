"""Routes of pages. An error is shown as a page with its message."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any, TypeVar
from urllib.parse import parse_qsl

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse
from fastapi.routing import APIRoute
from pydantic import BaseModel, BeforeValidator, ValidationError

from farm.errors import ErrorCode, FarmError, NotFoundError
from farm.text import describe_first_error
from farm.web.pages.rendering import render_message

_MAX_FIELDS = 20
_NOT_FOUND, _BAD_REQUEST = 404, 400
_Query = TypeVar("_Query", bound=BaseModel)
EMPTY_FIELD_VALIDATOR = BeforeValidator(lambda value: None if value == "" else value)
"""Validator that treats an empty field of a form as missing."""


def read_query(model: type[_Query], text: str) -> _Query:
    """Parse the query of a URL when a live page is rendered anew, without a request. Raises FarmError."""
    try:
        return model.model_validate(dict(parse_qsl(text, max_num_fields=_MAX_FIELDS)))
    except ValidationError as error:
        raise FarmError(describe_first_error(error.errors()), ErrorCode.SETTINGS) from error
    except ValueError as error:
        raise FarmError("the query in the URL is invalid", ErrorCode.SETTINGS) from error


class PageRoute(APIRoute):
    """Route of a page. A `FarmError`, or an invalid value in the URL, is shown as a page with a message."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of requests."""
        handle = super().get_route_handler()

        async def answer_request(request: Request) -> Response:
            try:
                return await handle(request)
            except FarmError as error:
                text, status = str(error), _NOT_FOUND if isinstance(error, NotFoundError) else _BAD_REQUEST
            except RequestValidationError as error:
                text, status = describe_first_error(error.errors()), _BAD_REQUEST
            return HTMLResponse(render_message(request.app.state.controller.fleet.fleet.name, text), status)

        return answer_request
