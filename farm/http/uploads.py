"""Uploads of models, within `fleet.uploads`: received into a file, then inspected in a worker."""

from __future__ import annotations

import asyncio
import shutil
import uuid
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Request
from pydantic import ValidationError
from starlette.requests import ClientDisconnect

from decompose.errors import ModelTooDetailed
from decompose.files.triangle_limit import HEAD_BYTES, check_head
from farm import api
from farm.config import UploadsSection
from farm.control import JobCommands
from farm.errors import ErrorCode, FarmError, NoSuchThing, Refused
from farm.http.callers import CallerName
from farm.http.services import Services
from farm.model import JobOptions
from farm.planning import InspectedSubmission, step_file
from farm.planning.inspection import name_filament
from farm.planning.tasks import inspect_submission
from farm.text import flatten_text, format_count

_GB = 1e9
_LONGEST_NAME = 60  # characters
_MODEL_BODY = {
    "required": True,
    "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
}


def upload_routes(services: Services, jobs: JobCommands) -> APIRouter:
    """Return the routes of submissions."""
    router, uploads = APIRouter(), Uploads(services)

    @router.post("/jobs", response_model_exclude_defaults=True, openapi_extra={"requestBody": _MODEL_BODY})
    async def submit(
        request: Request,
        request_id: Annotated[str, Query(min_length=8, max_length=64)],
        name: Annotated[str, Query(min_length=1, max_length=200)],
        size: Annotated[int, Query(ge=0)],
        by: CallerName,
        options: str = "{}",
    ) -> api.Submitted:
        wanted = parse_options(options)
        known = jobs.find_submission(request_id)
        if known is not None:
            return api.Submitted(job=known, again=True)
        jobs.check_submission(wanted)
        fleet = services.controller.fleet
        wanted = await asyncio.to_thread(name_filament, wanted, fleet.printers, fleet.fleet.materials)
        name = clean_name(name)
        model = await uploads.receive_model(request.stream(), request_id, name, size, wanted)
        number, again = jobs.submit(request_id, name, model, wanted, by)
        return api.Submitted(job=number, again=again, notices=jobs.find_excess(wanted))

    @router.get("/uploads/{request_id}")
    async def upload(request_id: str) -> api.UploadView:
        return uploads.describe(request_id)

    return router


def clean_name(name: str) -> str:
    """Convert a model's name to a printable, valid file name of limited length, without its folder."""
    last = name.replace("\\", "/").rpartition("/")[2]
    plain = flatten_text(last).lstrip(".")
    return plain[-_LONGEST_NAME:] or "model"


def parse_options(options: str) -> JobOptions:
    """Parse the options of a submission. Raises FarmError if one is wrong."""
    try:
        return JobOptions.model_validate_json(options)
    except ValidationError as error:
        raise FarmError(f"bad options: {error.errors()[0]['msg']}", ErrorCode.SETTINGS) from error


def check_quota(
    quota: UploadsSection, name: str, size: int, missing_bytes: Sequence[int], free_bytes: int, open_jobs: int
) -> None:
    """Refuse an upload that exceeds the limits on number or size.

    Parameters
    ----------
    quota
        The limits.
    name, size
        Name of the upload, and its size in bytes.
    missing_bytes
        Bytes of each open upload that have not arrived yet.
    free_bytes
        Free space on the disk of the state folder.
    open_jobs
        The number of jobs that have not ended.

    Raises
    ------
    Refused
        The message names the key in `fleet.yaml` that sets the limit.
    """
    if size > quota.model_gb * _GB:
        raise Refused(
            f"{name} has {size / _GB:.1f} GB; the largest model may have {quota.model_gb:g} GB: "
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
    if quota.free_gb and left_bytes < quota.free_gb * _GB:
        raise Refused(
            f"{name} would leave {max(0.0, left_bytes / _GB):.1f} GB free on the disk of the state folder, "
            f"where {quota.free_gb:g} GB must stay free: delete files there, or lower "
            "`fleet.uploads.free_gb` in fleet.yaml"
        )


@dataclass(slots=True)
class _Upload:
    """Upload that is being received or inspected."""

    request_id: str
    size: int
    missing_bytes: int


class Uploads:
    """Open uploads, whose total is limited."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._open: dict[Path, _Upload] = {}

    def describe(self, request_id: str) -> api.UploadView:
        """Describe the progress of an upload. Raises NoSuchThing."""
        for path, upload in self._open.items():
            if upload.request_id == request_id:
                step = "sending" if upload.missing_bytes else self._describe_wait()
                with suppress(OSError):  # inspection has not started, or has ended
                    step = step_file(path).read_text() or step
                return api.UploadView(
                    step=step, received=upload.size - upload.missing_bytes, size=upload.size
                )
        raise NoSuchThing(f"there is no open upload {request_id}")

    def _describe_wait(self) -> str:
        starting = self._services.workers.starting
        return "waiting for a worker" if starting is None else f"waiting for the workers to start: {starting}"

    async def receive_model(
        self, content: AsyncIterator[bytes], request_id: str, name: str, size: int, options: JobOptions
    ) -> InspectedSubmission:
        """Receive a model and inspect it.

        Parameters
        ----------
        content
            The bytes of the file, in chunks.
        request_id
            Identifies the upload in `describe`.
        name
            The name of the model, for messages.
        size
            The announced number of bytes.
        options
            The options of the job.

        Raises
        ------
        Refused
            As `check_quota`; or if the number of bytes differs from the announced size.
        FarmError
            If the model cannot be printed; `limit` as soon as its first bytes give too many triangles.
        """
        self._check_quota(name, size)
        controller, state = self._services.controller, self._services.state
        path = state.work / f"upload-{uuid.uuid4().hex}"
        upload = self._open[path] = _Upload(request_id, size, size)
        try:
            await self._write_content(content, path, name, upload)
            self._services.inspections[path] = name
            return await self._services.workers.run(
                inspect_submission, path, name, options, controller.fleet.printers, state.files
            )
        finally:
            path.unlink(missing_ok=True)
            step_file(path).unlink(missing_ok=True)
            del self._open[path]
            self._services.inspections.pop(path, None)

    async def _write_content(
        self, content: AsyncIterator[bytes], path: Path, name: str, upload: _Upload
    ) -> None:
        """Write an upload to a file. Raises FarmError if it is incomplete or has too many triangles."""
        head = b""
        with path.open("wb") as file, suppress(ClientDisconnect):  # detected below by the number of bytes
            async for chunk in content:
                upload.missing_bytes -= len(chunk)
                if upload.missing_bytes < 0:
                    break
                if len(head) < HEAD_BYTES:
                    head += chunk[:HEAD_BYTES]
                    if len(head) >= min(upload.size, HEAD_BYTES):
                        self._check_head(name, head, upload.size)
                file.write(chunk)
        if upload.missing_bytes:
            received = upload.size - upload.missing_bytes
            raise Refused(
                f"the upload of {name} stopped after {received} of {upload.size} bytes; submit it again"
            )

    def _check_head(self, name: str, head: bytes, size: int) -> None:
        """Refuse a model whose first bytes give more triangles than a worker has memory for."""
        try:
            check_head(name, head, size, Path(name).suffix.lower(), self._services.workers.memory_bytes)
        except ModelTooDetailed as error:
            detail = f"{error}, or raise `fleet.compute.memory_gb` in fleet.yaml"
            raise FarmError(detail, ErrorCode.LIMIT) from error

    def _check_quota(self, name: str, size: int) -> None:
        """Refuse an upload that exceeds a limit in the present state of the farm."""
        controller = self._services.controller
        check_quota(
            controller.fleet.fleet.uploads,
            name,
            size,
            [upload.missing_bytes for upload in self._open.values()],
            shutil.disk_usage(self._services.state.root).free,
            sum(not job.state.ended for job in controller.books.jobs.values()),
        )
