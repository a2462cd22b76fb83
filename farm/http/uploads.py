"""Uploads of models, within `fleet.uploads`: received into a file, then inspected in a worker."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from pathlib import Path

from pydantic import ValidationError
from starlette.requests import ClientDisconnect

from farm.config import UploadsSection
from farm.errors import ErrorCode, FarmError, Refused
from farm.http.services import Services
from farm.model import JobOptions
from farm.planning.plan import InspectedSubmission
from farm.planning.tasks import inspect_submission
from farm.text import flatten_text, format_count

_GB = 1e9
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


def check_quota(
    quota: UploadsSection, name: str, size: int, missing_bytes: Sequence[int], free_bytes: int, open_jobs: int
) -> None:
    """Refuse an upload that would be one too many, or too large.

    Parameters
    ----------
    quota
        What people may send.
    name, size
        Of the upload, in bytes.
    missing_bytes
        What is still to come of each upload under way.
    free_bytes
        Room on the disk of the state folder.
    open_jobs
        How many jobs have not ended.

    Raises
    ------
    Refused
        With the key in `fleet.yaml` that sets the limit.
    """
    if size > quota.model_gb * _GB:
        raise Refused(
            f"{name} has {size / _GB:.1f} GB, and models of {quota.model_gb:g} GB at most are taken: "
            "simplify its mesh, or raise `fleet.uploads.model_gb` in fleet.yaml"
        )
    if len(missing_bytes) >= quota.at_once:
        raise Refused(
            f"{format_count(len(missing_bytes), 'model')} being received and checked already: submit {name} "
            "again in a moment, or raise `fleet.uploads.at_once` in fleet.yaml"
        )
    if open_jobs >= quota.open_jobs:
        raise Refused(
            f"{format_count(open_jobs, 'open job')} already: cancel some with `farm cancel JOB`, or raise "
            "`fleet.uploads.open_jobs` in fleet.yaml"
        )
    left_bytes = free_bytes - sum(missing_bytes) - size
    if left_bytes < quota.free_gb * _GB:
        raise Refused(
            f"{name} would leave {max(0.0, left_bytes / _GB):.1f} GB on the disk of the state folder, and "
            f"{quota.free_gb:g} GB stay free: make room there, or lower `fleet.uploads.free_gb` in fleet.yaml"
        )


class Uploads:
    """Uploads under way.

    Parameters
    ----------
    services
        Has the workers, the state folder, the fleet and its jobs.
    """

    def __init__(self, services: Services) -> None:
        self._services = services
        self._missing_bytes: dict[Path, int] = {}

    async def receive_model(
        self, content: AsyncIterator[bytes], name: str, size: int, options: JobOptions
    ) -> InspectedSubmission:
        """Receive a model and inspect it.

        Parameters
        ----------
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
            As `check_quota`; or where fewer or more bytes come than were announced.
        FarmError
            Where the model cannot be printed.
        """
        controller, state = self._services.controller, self._services.state
        check_quota(
            controller.fleet.fleet.uploads,
            name,
            size,
            tuple(self._missing_bytes.values()),
            shutil.disk_usage(state.root).free,
            sum(not job.state.ended for job in controller.books.jobs.values()),
        )
        upload = state.work / f"upload-{uuid.uuid4().hex}"
        self._missing_bytes[upload] = size
        try:
            with upload.open("wb") as file, suppress(ClientDisconnect):  # what came is too little then
                async for chunk in content:
                    self._missing_bytes[upload] -= len(chunk)
                    if self._missing_bytes[upload] < 0:
                        break
                    file.write(chunk)
            if self._missing_bytes[upload]:
                received = size - self._missing_bytes[upload]
                raise Refused(
                    f"the upload of {name} stopped after {received} of {size} bytes; submit it again"
                )
            return await self._services.workers.run(
                inspect_submission, upload, name, options, controller.fleet.printers, state.files
            )
        finally:
            upload.unlink(missing_ok=True)
            del self._missing_bytes[upload]
