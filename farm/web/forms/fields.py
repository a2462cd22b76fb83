"""Fields of forms without a file."""

from __future__ import annotations

from urllib.parse import parse_qsl

from starlette.requests import Request

from farm.web.forms.multipart import BadForm

_MAX_FIELDS = 100


async def read_fields(request: Request) -> dict[str, str]:
    """Read the fields of a form by name; of several fields with one name, the last counts. Raises BadForm."""
    try:
        text = (await request.body()).decode("ascii")
        return dict(parse_qsl(text, keep_blank_values=True, max_num_fields=_MAX_FIELDS))
    except ValueError as error:
        raise BadForm("the form cannot be read: send it again from its page") from error
