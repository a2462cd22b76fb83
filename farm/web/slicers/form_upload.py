"""Uploads by slicers: the file in a form is submitted as a job, and fields of the form set its options."""

from __future__ import annotations

import uuid
from typing import NamedTuple

from starlette.requests import Request

from farm.control import JobCommands
from farm.http import Uploads
from farm.model import JobOptions
from farm.web.forms import FormReader, FormUploads

_MAX_NOTE_LENGTH = 200


class SlicerUpload(NamedTuple):
    """Number of the job that an upload created, and whether the slicer asked to print it."""

    job_number: int
    is_print_requested: bool


async def submit_form(
    request: Request, uploads: Uploads, jobs: JobCommands, options: JobOptions, caller_name: str
) -> SlicerUpload:
    """Receive a form with a model or G-code, and submit it; without `print=true` the job is held.

    Parameters
    ----------
    request
        The request, whose body has not been read.
    uploads, jobs
        Components of the daemon.
    options
        Options of the job, to which the fields of the form are added.
    caller_name
        Name of the caller.

    Raises
    ------
    FarmError, HTTPException
        See `FormUploads.submit`.
    """

    async def read_options(form: FormReader) -> JobOptions:
        folder = form.fields.get("path", "").strip("/ ")[:_MAX_NOTE_LENGTH]  # only shown, never opened
        form_options = {"hold": not form.is_true("print"), "note": folder or None}
        return JobOptions.model_validate({**options.model_dump(), **form_options})

    submitted_form = await FormUploads(uploads, jobs).submit(
        request, uuid.uuid4().hex, read_options, caller_name
    )
    return SlicerUpload(submitted_form.job_number, submitted_form.form.is_true("print"))
