"""Routes of the files of jobs: parts, plates, pictures, reports and stills."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse

from farm import api
from farm.errors import NotFoundError
from farm.http.services import Services
from farm.planning import list_job_files
from farm.state import Books

_CONTENT = {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}


def make_file_routes(services: Services) -> APIRouter:
    """Return the routes of files. They look a name up among the job's files, and never use it as a path."""
    router, controller = APIRouter(), services.controller

    @router.get("/jobs/{number}/files")
    async def list_files(number: int) -> api.JobFiles:
        names = map_stored_files(controller.books, number)
        rows = await asyncio.to_thread(_list_existing_files, services.state.files, names)
        return api.JobFiles(job=number, files=rows)

    @router.get("/jobs/{number}/files/{name}", response_class=FileResponse, responses={200: _CONTENT})
    async def send_file(number: int, name: str) -> FileResponse:
        path = await find_stored_file(services, number, name)
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    return router


def map_stored_files(books: Books, number: int) -> dict[str, str]:
    """Map the public name of each file of a job to its name in the file store. Raises NotFoundError."""
    job = books.get_job(number)
    names = list_job_files(job, map(books.parts.__getitem__, job.parts), books.list_plates(job))
    if job.pruned_s is None:
        prints = (attempt for plate in books.list_plates(job) for attempt in books.list_prints(plate))
        for attempt in prints:
            names |= {
                f"print-{attempt.number}-{still.moment}{Path(still.file).suffix}": still.file
                for still in attempt.stills
            }
    return names


async def find_stored_file(services: Services, number: int, name: str) -> Path:
    """Return the path of a file of a job by its name.

    Parameters
    ----------
    services
        Components of the daemon.
    number
        Number of the job.
    name
        One of the keys of `map_stored_files`; it is never used as a path.

    Raises
    ------
    NotFoundError
        If there is no such job, or it no longer has the file.
    """
    file_name = map_stored_files(services.controller.books, number).get(name)
    if file_name is not None and await asyncio.to_thread((path := services.state.files / file_name).is_file):
        return path
    raise NotFoundError(f"job {number} has no file {name!r}: it may have been pruned")


def _list_existing_files(folder: Path, names: dict[str, str]) -> list[api.FileView]:
    """Return the files that exist, with their sizes; a stored file is named by its SHA-256."""
    rows = []
    for name, file_name in names.items():
        with suppress(FileNotFoundError):
            size_bytes = (folder / file_name).stat().st_size
            rows.append(api.FileView(name=name, size=size_bytes, sha256=Path(file_name).stem))
    return rows
