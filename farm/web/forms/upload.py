"""Uploads in forms: a file is written to the state folder in chunks, inspected, and submitted as a job."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from typing import NamedTuple

from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request

from farm.control import JobCommands
from farm.errors import FarmError
from farm.http import Upload, Uploads, clean_name
from farm.model import JobOptions
from farm.planning import InspectedSubmission
from farm.web.forms.multipart import BadForm, FormReader

_LENGTH_REQUIRED = 411
_MAX_DISCARDED_BYTES = 2**30
_PLACEHOLDER_NAME = "the upload"  # name in messages until the file's name is known
ReadOptions = Callable[[FormReader], Awaitable[JobOptions]]
"""Function that reads the options of a job from a complete form. Raises FarmError."""


class SubmittedForm(NamedTuple):
    """Form whose file was submitted, and the number of the job."""

    job_number: int
    form: FormReader


@dataclass(frozen=True, slots=True)
class FormUploads:
    """Receiver of forms that contain a model or G-code file, which is submitted as a job.

    Attributes
    ----------
    uploads, jobs
        Components of the daemon.
    """

    uploads: Uploads
    jobs: JobCommands

    async def submit(
        self, request: Request, request_id: str, read_options: ReadOptions, caller_name: str
    ) -> SubmittedForm:
        """Receive a form, and submit its file.

        Parameters
        ----------
        request
            The request, whose body has not been read.
        request_id
            Id of the upload and of the submission.
        read_options
            Function that reads the options of the job from the fields.
        caller_name
            Name of the caller.

        Raises
        ------
        FarmError
            If the form is malformed or incomplete, or its model exceeds a limit or cannot be printed.
        HTTPException
            If the request does not give the length of its body.
        """
        size = request.headers.get("content-length", "")
        # the length of a chunked body is not known in advance
        if not size.isdecimal() or "transfer-encoding" in request.headers:
            raise HTTPException(
                _LENGTH_REQUIRED, "the request has no Content-Length: send the length of the upload"
            )
        content = request.stream()
        try:
            self.jobs.check_submission(JobOptions())
            reader = FormReader(request.headers.get("content-type", ""))
            async with self.uploads.admit(request_id, _PLACEHOLDER_NAME, int(size)) as upload:
                name = await _receive_file(content, reader, upload)
                options = await read_options(reader)
                self.jobs.check_submission(options)
                model = await self._inspect_upload(upload, name, options)
        except (FarmError, OSError):
            if int(size) <= _MAX_DISCARDED_BYTES and "expect" not in request.headers:
                await _discard_rest(content)
            raise
        number, _ = self.jobs.submit(request_id, name, model, options, caller_name)
        return SubmittedForm(number, reader)

    async def _inspect_upload(self, upload: Upload, name: str, options: JobOptions) -> InspectedSubmission:
        """Inspect an upload. Errors omit the file's name: a slicer shows it anyway, and has little space."""
        try:
            return await self.uploads.inspect(upload, name, options)
        except FarmError as error:
            raise FarmError(str(error).removeprefix(f"{name}: "), error.code) from error


async def _discard_rest(content: AsyncIterator[bytes]) -> None:
    """Discard the rest of a refused upload, because clients read the response only after the whole upload."""
    with suppress(ClientDisconnect):
        async for _ in content:
            pass


async def _receive_file(content: AsyncIterator[bytes], reader: FormReader, upload: Upload) -> str:
    """Write the file in a form to the file of an upload, and return its name. Raises FarmError."""
    name = _PLACEHOLDER_NAME
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
