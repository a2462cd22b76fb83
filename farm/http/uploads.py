"""Uploads of models, within the limits of `fleet.uploads`: received as files, then inspected in a worker."""

from __future__ import annotations

import asyncio
import shutil
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from pydantic import ValidationError
from starlette.requests import ClientDisconnect

from decompose.errors import ModelTooDetailed
from decompose.files.triangle_limit import HEAD_BYTES, check_head
from farm import api
from farm.compute import Pool
from farm.config import UploadsSection
from farm.control import Controller
from farm.errors import ErrorCode, FarmError, NotFoundError, RefusedError
from farm.model import JobOptions
from farm.paths import StateFolder
from farm.planning import InspectedSubmission, make_inspection_step_path
from farm.planning.tasks import inspect_submission
from farm.text import flatten_text, format_count

_GB = 1e9
_MAX_NAME_LENGTH = 60  # number of characters
_WRITE_BYTES = 2**20
"""Size of one write in bytes; larger than a chunk, because each write needs a thread."""


def clean_name(name: str) -> str:
    """Convert the name of a model to a valid, printable file name of limited length, without a folder."""
    base_name = name.replace("\\", "/").rpartition("/")[2]
    plain_name = flatten_text(base_name).lstrip(".")
    return plain_name[-_MAX_NAME_LENGTH:] or "model"


def parse_options(text: str) -> JobOptions:
    """Parse the options of a submission. Raises FarmError if they are invalid."""
    try:
        return JobOptions.model_validate_json(text)
    except ValidationError as error:
        raise FarmError(f"invalid options: {error.errors()[0]['msg']}", ErrorCode.SETTINGS) from error


def check_quota(
    quota: UploadsSection,
    name: str,
    size_bytes: int,
    missing_byte_counts: Sequence[int],
    free_bytes: int,
    open_job_count: int,
) -> None:
    """Refuse an upload that exceeds the limits on number or size.

    Parameters
    ----------
    quota
        The limits.
    name, size_bytes
        Name of the upload, and its announced size.
    missing_byte_counts
        Number of bytes of each open upload that have not arrived yet.
    free_bytes
        Free space on the disk of the state folder.
    open_job_count
        The number of jobs that have not ended.

    Raises
    ------
    RefusedError
        If the upload exceeds a limit; the message names the key of this limit in `fleet.yaml`.
    """
    if size_bytes > quota.model_gb * _GB:
        raise RefusedError(
            f"{name} is {size_bytes / _GB:.1f} GB; a model may be at most {quota.model_gb:g} GB: "
            "simplify its mesh, or raise `fleet.uploads.model_gb` in fleet.yaml"
        )
    if len(missing_byte_counts) >= quota.at_once:
        raise RefusedError(
            f"already receiving and checking {format_count(len(missing_byte_counts), 'model')}: submit "
            f"{name} again in a moment, or raise `fleet.uploads.at_once` in fleet.yaml"
        )
    if open_job_count >= quota.open_jobs:
        raise RefusedError(
            f"{format_count(open_job_count, 'open job')} already: cancel some with `farm cancel JOB`, or "
            "raise `fleet.uploads.open_jobs` in fleet.yaml"
        )
    remaining_bytes = free_bytes - sum(missing_byte_counts) - size_bytes
    if quota.free_gb and remaining_bytes < quota.free_gb * _GB:
        raise RefusedError(
            f"{name} would leave {max(0.0, remaining_bytes / _GB):.1f} GB free on the disk of the state "
            f"folder, where {quota.free_gb:g} GB must stay free: delete files there, or lower "
            "`fleet.uploads.free_gb` in fleet.yaml"
        )


class Upload:
    """Upload that is being received or inspected, and its file.

    Attributes
    ----------
    request_id
        Id with which a client requests the progress of the upload.
    size_bytes
        Announced number of bytes of the request's body.
    missing_bytes
        Bytes of the body that have not arrived yet.
    path
        The file; it is deleted when the upload ends.
    """

    def __init__(self, request_id: str, size_bytes: int, path: Path, memory_bytes: int) -> None:
        self.request_id, self.path = request_id, path
        self.size_bytes = self.missing_bytes = size_bytes
        self._memory_bytes = memory_bytes

    @asynccontextmanager
    async def open_file(self, name: str) -> AsyncIterator[Callable[[bytes], Awaitable[None]]]:
        """Open the file, and yield a function that appends content to it.

        Threads write the file, because a write to a slow disk would block the event loop for seconds.

        Raises
        ------
        FarmError
            With code `limit`, as soon as the first bytes state more triangles than a worker's memory holds.
        """
        head, is_checked, unwritten_bytes = b"", False, bytearray()

        async def append(content: bytes) -> None:
            nonlocal head, is_checked, unwritten_bytes
            if not is_checked:
                head += content[:HEAD_BYTES]
                if len(head) >= min(self.size_bytes, HEAD_BYTES):
                    is_checked = True
                    self._check_head(name, head)
            unwritten_bytes += content
            if len(unwritten_bytes) >= _WRITE_BYTES:
                full_block, unwritten_bytes = unwritten_bytes, bytearray()
                await asyncio.to_thread(file.write, full_block)

        with self.path.open("wb") as file:
            yield append
            if not is_checked:
                self._check_head(name, head)
            await asyncio.to_thread(file.write, unwritten_bytes)

    def _check_head(self, name: str, head: bytes) -> None:
        try:
            check_head(name, head, self.size_bytes, Path(name).suffix.lower(), self._memory_bytes)
        except ModelTooDetailed as error:
            detail = f"{error}, or raise `fleet.compute.memory_gb` in fleet.yaml"
            raise FarmError(detail, ErrorCode.LIMIT) from error


class Uploads:
    """Open uploads, which are limited in number and total size.

    Parameters
    ----------
    controller
        Controller of the farm, with the limits on uploads.
    state
        The state folder, in which the uploads are stored.
    workers
        Processes that inspect models.
    inspections
        Names of the models that are being inspected, by file; kept up to date by this class.
    """

    def __init__(
        self, controller: Controller, state: StateFolder, workers: Pool, inspections: dict[Path, str]
    ) -> None:
        self._controller, self._state, self._workers = controller, state, workers
        self._inspections = inspections
        self._open_uploads: dict[Path, Upload] = {}

    def describe(self, request_id: str) -> api.UploadView:
        """Describe the progress of an upload. Raises NotFoundError if it is not open."""
        for path, upload in self._open_uploads.items():
            if upload.request_id == request_id:
                step = "sending" if upload.missing_bytes else self._describe_wait()
                with suppress(OSError):  # the inspection has not started, or has ended
                    step = make_inspection_step_path(path).read_text() or step
                return api.UploadView(
                    step=step, received=upload.size_bytes - upload.missing_bytes, size=upload.size_bytes
                )
        raise NotFoundError(f"there is no open upload {request_id}")

    def _describe_wait(self) -> str:
        start_step = self._workers.start_step
        if start_step is None:
            return "waiting for a worker"
        return f"waiting for the workers to start: {start_step}"

    @asynccontextmanager
    async def admit(self, request_id: str, name: str, size_bytes: int) -> AsyncIterator[Upload]:
        """Register an upload that is within the limits; delete its file when the context ends.

        Parameters
        ----------
        request_id
            Id of the upload for `describe`.
        name
            The name of the model, for messages.
        size_bytes
            The announced number of bytes.

        Raises
        ------
        RefusedError
            If the upload exceeds a limit (see `check_quota`).
        """
        self._check_quota(name, size_bytes)
        path = self._state.work / f"upload-{uuid.uuid4().hex}"
        upload = self._open_uploads[path] = Upload(request_id, size_bytes, path, self._workers.memory_bytes)
        try:
            yield upload
        finally:
            del self._open_uploads[path]
            await asyncio.to_thread(_delete_files, path)  # takes a tenth of a second for the largest models

    async def inspect(self, upload: Upload, name: str, options: JobOptions) -> InspectedSubmission:
        """Inspect a complete upload in a worker. Raises FarmError if the model cannot be printed."""
        printers, files = self._controller.fleet.printers, self._state.files
        self._inspections[upload.path] = name
        try:
            return await self._workers.run(inspect_submission, upload.path, name, options, printers, files)
        finally:
            self._inspections.pop(upload.path, None)

    async def receive_model(
        self, content: AsyncIterator[bytes], request_id: str, name: str, size_bytes: int, options: JobOptions
    ) -> InspectedSubmission:
        """Receive a model and inspect it.

        Parameters
        ----------
        content
            The bytes of the file, in chunks.
        request_id, name, size_bytes
            See `admit`.
        options
            The options of the job.

        Raises
        ------
        RefusedError
            If the upload exceeds a limit (see `check_quota`), or its size differs from the announced size.
        FarmError
            If the model cannot be printed; with code `limit`, as soon as its first bytes state too many
            triangles.
        """
        async with self.admit(request_id, name, size_bytes) as upload:
            async with upload.open_file(name) as append:
                with suppress(ClientDisconnect):  # the check of the size below detects it
                    async for chunk in content:
                        upload.missing_bytes -= len(chunk)
                        if upload.missing_bytes < 0:
                            break
                        await append(chunk)
            if upload.missing_bytes:
                received_bytes = size_bytes - upload.missing_bytes
                raise RefusedError(
                    f"the upload of {name} stopped after {received_bytes} of {size_bytes} bytes; submit "
                    "it again"
                )
            return await self.inspect(upload, name, options)

    def _check_quota(self, name: str, size_bytes: int) -> None:
        """Refuse an upload that exceeds a limit in the current state of the farm."""
        controller = self._controller
        check_quota(
            controller.fleet.fleet.uploads,
            name,
            size_bytes,
            [upload.missing_bytes for upload in self._open_uploads.values()],
            shutil.disk_usage(self._state.root).free,
            sum(not job.state.ended for job in controller.books.jobs.values()),
        )


def _delete_files(path: Path) -> None:
    """Delete the file of an upload, and the file with the step of its inspection."""
    path.unlink(missing_ok=True)
    make_inspection_step_path(path).unlink(missing_ok=True)
