"""Routes of forms: the models of the API parse the fields, and an error is shown as a note on the page.

The response to a form redirects to the page that sent it, so that a reload does not send the form again.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any, TypeVar
from urllib.parse import urlsplit

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import RedirectResponse
from fastapi.routing import APIRoute
from pydantic import BaseModel, ValidationError

from farm.errors import FarmError
from farm.text import describe_first_error
from farm.web.callers import find_holder
from farm.web.forms import read_fields
from farm.web.notes import Note

_SEE_OTHER = 303
_Model = TypeVar("_Model", bound=BaseModel)


class FormRoute(APIRoute):
    """Route of a form. An error is shown as a note on the page that sent the form."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()

        async def answer_request(request: Request) -> Response:
            try:
                return await handle(request)
            except FarmError as error:
                text = str(error)
            except (RequestValidationError, ValidationError) as error:
                text = describe_first_error(error.errors())
            return answer_form(request, Note(text, is_problem=True))

        return answer_request


async def read_form(request: Request, model: type[_Model]) -> _Model:
    """Parse the fields of a form into a model; empty fields count as missing.

    Raises ValidationError or BadForm.
    """
    fields = await read_fields(request)
    return model.model_validate({name: value for name, value in fields.items() if value})


def answer_form(request: Request, note: Note, path: str | None = None) -> Response:
    """Return a redirect to a page, which will show the note.

    Parameters
    ----------
    request
        Request with the form.
    note
        Result of the command that the form sent.
    path
        Path of the page; by default, the path of the page that sent the form.
    """
    request.app.state.notes.put(find_holder(request).key.id, note)
    return RedirectResponse(path or find_referring_path(request), _SEE_OTHER)


def find_referring_path(request: Request) -> str:
    """Return the path of the page that sent a form, or the path of the home page if it is unknown."""
    page = urlsplit(request.headers.get("referer", ""))
    if page.netloc != request.headers.get("host") or not page.path.startswith("/"):
        return "/"
    path = "/" + page.path.lstrip("/")  # `//name` would be another host
    return f"{path}?{page.query}" if page.query else path
