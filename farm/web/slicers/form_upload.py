"""Uploads as forms: received into the state folder as they arrive, inspected, and submitted as jobs."""

from __future__ import annotations

import uuid
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from typing import NamedTuple

from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request

from farm.control import JobCommands
from farm.errors import FarmError
from farm.http import Upload, Uploads, clean_name
from farm.model import JobOptions
from farm.planning import InspectedSubmission
from farm.web.slicers.multipart import BadForm, FormReader

_LENGTH_REQUIRED = 411
_LONGEST_NOTE = 200
_MOST_DISCARDED_BYTES = 2**30
_ANY_NAME = "the upload"  # until its name is known


class SubmittedForm(NamedTuple):
    """Number of an upload's job, and whether the slicer asked to print it."""

    job: int
    print_requested: bool


async def submit_form(
    request: Request, uploads: Uploads, jobs: JobCommands, options: JobOptions, by: str
) -> SubmittedForm:
    """Receive a form with a model or G-code, and submit it; without `print=true` the job is held.

    Parameters
    ----------
    request
        The request, whose body has not been read.
    uploads, jobs
        Components of the daemon.
    options
        Options of the job, to which those of the form are added.
    by
        Name of the caller.

    Raises
    ------
    FarmError
        If the form is malformed or cut, exceeds a limit, or cannot be printed.
    HTTPException
        If the length of the body is not announced.
    """
    size = request.headers.get("content-length", "")
    if not size.isdecimal() or "transfer-encoding" in request.headers:  # chunks have no length before
        raise HTTPException(_LENGTH_REQUIRED, "the request has no Content-Length: the farm needs it first")
    content = request.stream()
    request_id = uuid.uuid4().hex
    try:
        jobs.check_submission(options)
        reader = FormReader(request.headers.get("content-type", ""))
        async with uploads.admit(request_id, _ANY_NAME, int(size)) as upload:
            name = await _receive_file(content, reader, upload)
            wanted = _read_options(reader, options)
            model = await _inspect(uploads, upload, name, wanted)
    except (FarmError, OSError):
        if int(size) <= _MOST_DISCARDED_BYTES and "expect" not in request.headers:
            await _discard(content)
        raise
    number, _ = jobs.submit(request_id, name, model, wanted, by)
    return SubmittedForm(number, reader.is_true("print"))


def _read_options(reader: FormReader, options: JobOptions) -> JobOptions:
    """Return the options of a job with those of its form; a folder is only shown."""
    folder = reader.fields.get("path", "").strip("/ ")[:_LONGEST_NOTE]
    own = {"hold": not reader.is_true("print"), "note": folder or None}
    return JobOptions.model_validate({**options.model_dump(), **own})


async def _inspect(uploads: Uploads, upload: Upload, name: str, options: JobOptions) -> InspectedSubmission:
    """Inspect an upload. Its errors lack its name, which a slicer shows itself, in front of few letters."""
    try:
        return await uploads.inspect(upload, name, options)
    except FarmError as error:
        raise FarmError(str(error).removeprefix(f"{name}: "), error.code) from error


async def _discard(content: AsyncIterator[bytes]) -> None:
    """Read the rest of a refused upload: who is still sending does not read the answer."""
    with suppress(ClientDisconnect):
        async for _ in content:
            pass


async def _receive_file(content: AsyncIterator[bytes], reader: FormReader, upload: Upload) -> str:
    """Write the file of a form to the upload's file, and return its name. Raises FarmError."""
    name = _ANY_NAME
    append: Callable[[bytes], Awaitable[None]] | None = None
    async with AsyncExitStack() as files:
        try:
            async for chunk in content:
                upload.missing_bytes -= len(chunk)
                if upload.missing_bytes < 0:
                    raise BadForm("the upload is longer than its Content-Length: send it again")
                for piece in reader.feed(chunk):
                    if append is None:
                        name = clean_name(reader.file_name or "")
                        append = await files.enter_async_context(upload.open_file(name))
                    await append(piece)
        except ClientDisconnect as error:
            raise BadForm("the upload stopped before its end: send it again") from error
        reader.finish()
    if append is None:
        raise BadForm("the file is empty")
    return name
