"""Uploads of models: received into a file of their own, then inspected in a worker."""

from __future__ import annotations

import uuid
from collections.abc import AsyncIterator
from contextlib import suppress

from pydantic import ValidationError
from starlette.requests import ClientDisconnect

from farm.errors import ErrorCode, FarmError, Refused
from farm.http.services import Services
from farm.model import JobOptions
from farm.planning.plan import InspectedSubmission
from farm.planning.tasks import inspect_submission
from farm.text import flatten_text

LARGEST_MODEL_BYTES = 2 * 1024**3
_LONGEST_NAME = 60  # characters, so that it can be a file's name too


def display_name(name: str) -> str:
    """Return a model's name without its folder: printable, on one line, fit for a file's name."""
    last = name.replace("\\", "/").rpartition("/")[2]
    plain = flatten_text(last).lstrip(".")
    return plain[-_LONGEST_NAME:] or "model"


def parse_options(options: str) -> JobOptions:
    """Return the options of a submission from their JSON. Raises FarmError."""
    try:
        return JobOptions.model_validate_json(options)
    except ValidationError as error:
        raise FarmError(f"bad options: {error.errors()[0]['msg']}", ErrorCode.SETTINGS) from error


async def receive_model(
    services: Services, content: AsyncIterator[bytes], name: str, size: int, options: JobOptions
) -> InspectedSubmission:
    """Receive a model and inspect it.

    Parameters
    ----------
    services
        Has the workers and the state folder.
    content
        The bytes, as they come.
    name
        How the model is called.
    size
        Bytes that were announced.
    options
        How the model is to be printed.

    Raises
    ------
    Refused
        Where fewer or more bytes come than were announced.
    FarmError
        Where the model cannot be printed.
    """
    state = services.state
    upload = state.work / f"upload-{uuid.uuid4().hex}"
    try:
        received = 0
        with upload.open("wb") as file, suppress(ClientDisconnect):  # what came is too little then
            async for chunk in content:
                received += len(chunk)
                if received > size:
                    break
                file.write(chunk)
        if received != size:
            raise Refused(f"the upload of {name} stopped after {received} of {size} bytes; submit it again")
        printers = services.controller.fleet.printers
        return await services.workers.run(inspect_submission, upload, name, options, printers, state.files)
    finally:
        upload.unlink(missing_ok=True)
