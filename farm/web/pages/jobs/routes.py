"""Routes of a job's page, its instructions, its report and the archive of its parts."""

from __future__ import annotations

import asyncio
import time
import zipfile
from collections.abc import Iterator, Mapping
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, HTMLResponse, StreamingResponse
from pydantic import BaseModel

from farm import api
from farm.control import PAGE_DRY_RUN_TIMEOUT_S, DryRuns
from farm.errors import NotFoundError
from farm.http import Services, describe_farm, find_stored_file, map_stored_files
from farm.views import describe_job, describe_timeline, list_history
from farm.views.report import JobContents, list_figures, render_page
from farm.views.report.decomposition import Report, parse_report
from farm.web.notes import Note, User
from farm.web.pages.jobs.job_page import JobData, list_gcode_figures, render_job_page
from farm.web.pages.page_context import PageContext
from farm.web.pages.page_route import EMPTY_FIELD_VALIDATOR, PageRoute, read_query

_INSTRUCTIONS_FILE, _PICTURE_FILE, _REPORT_FILE = "instructions.html", "assembly.png", "decomposition.json"
_DOCUMENT_HEADERS = {
    "content-security-policy": "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
    "frame-ancestors 'none'; base-uri 'none'"
}
"""Security policy of a stored page in a single file: it allows inline styles and pictures, but no script."""
_MAX_PRINTS = 2000  # maximum number of ended prints that a timeline considers
_CHUNK_BYTES = 1 << 18
_COMPRESSION_LEVEL = 1  # halves the size of an STL, at about 50 MB/s


class JobQuery(BaseModel):
    """Query of a job's page: number of the job whose time curve the page shows, if that is another job."""

    curve: Annotated[int | None, EMPTY_FIELD_VALIDATOR] = None


def make_job_page_routes(pages: PageContext, dry_runs: DryRuns) -> APIRouter:
    """Return the routes of a job's pages. A dry run does not end while its page is open."""
    router, services = APIRouter(route_class=PageRoute, include_in_schema=False), pages.services
    fleet = services.controller.fleet.fleet

    async def render(
        user: User, number: int, note: Note | None = None, time_curve_job: int | None = None
    ) -> str:
        dry_runs.keep(number, time.monotonic(), PAGE_DRY_RUN_TIMEOUT_S)
        report = await _read_stored_report(services, number)
        if time_curve_job is not None and not report.curve:
            time_curve_report = await _read_stored_report(services, time_curve_job)
            report = report.model_copy(update={"curve": time_curve_report.curve})
        data = collect_job_data(services, number, report, time_curve_job)
        return render_job_page(data, fleet, user, note)

    async def render_live(user: User, number: str, query: str) -> str:
        if not number.isdecimal():
            raise NotFoundError(f"there is no job {number}")
        return await render(user, int(number), time_curve_job=read_query(JobQuery, query).curve)

    pages.live_pages.add("/jobs/{number}", render_live)

    @router.get("/jobs/{number}")
    async def show_job(number: int, request: Request, query: Annotated[JobQuery, Query()]) -> Response:
        return await pages.answer(request, lambda user, note: render(user, number, note, query.curve))

    _add_document_routes(router, services)
    return router


def _add_document_routes(router: APIRouter, services: Services) -> None:
    """Add the routes of a job's instructions, report and archive of parts."""
    controller = services.controller

    @router.get("/jobs/{number}/instructions")
    async def show_instructions(number: int) -> Response:
        path = await find_stored_file(services, number, _INSTRUCTIONS_FILE)
        return FileResponse(path, media_type="text/html", headers=_DOCUMENT_HEADERS)

    @router.get("/jobs/{number}/parts.zip")
    async def send_parts(number: int) -> Response:
        files = map_stored_files(controller.books, number)
        parts = {name: services.state.files / file for name, file in files.items() if name.endswith(".stl")}
        for name in parts or ["parts.zip"]:
            # a missing file raises an error here, before an incomplete archive is sent
            await find_stored_file(services, number, name)
        headers = {"content-disposition": f'attachment; filename="job-{number}-parts.zip"'}
        return StreamingResponse(generate_archive(parts), media_type="application/zip", headers=headers)

    @router.get("/jobs/{number}/report")
    async def show_report(number: int) -> Response:
        context = controller.build_view_context(services.state)
        job = describe_job(context, controller.books.get_job(number))
        history = list_history(context, None, None, _MAX_PRINTS)
        try:
            path = await find_stored_file(services, number, _PICTURE_FILE)
            picture = await asyncio.to_thread(path.read_bytes)
        except (NotFoundError, OSError):
            picture = None
        now = datetime.fromtimestamp(context.now_s, controller.fleet.zone)
        contents = JobContents({}, picture, await _read_stored_report(services, number))
        page = render_page(job, history, now, list_figures(job), contents)
        return HTMLResponse(page, headers=_DOCUMENT_HEADERS)


async def _read_stored_report(services: Services, number: int) -> Report:
    """Read the report on a job's decomposition; return an empty report if it is missing or unreadable."""
    file_name = map_stored_files(services.controller.books, number).get(_REPORT_FILE)
    if file_name is None:
        return Report()
    try:
        return await asyncio.to_thread(_read_report, services.state.files / file_name)
    except OSError:  # the page is useful without its report
        return Report()


@lru_cache(maxsize=32)
def _read_report(path: Path) -> Report:
    """Read a report. It is cached, because a stored file never changes, and a live page is rendered often.

    Raises
    ------
    OSError
        If the report cannot be read. Errors are not cached, because they may be temporary.
    """
    return parse_report(path.read_bytes())


def collect_job_data(services: Services, number: int, report: Report, time_curve_job: int | None) -> JobData:
    """Collect the data of a job's page. Raises NotFoundError for an unknown job."""
    controller = services.controller
    context = controller.build_view_context(services.state)
    job = controller.books.get_job(number)
    timeline: api.Timeline | None = None
    if job.plates and not job.state.ended:
        timeline = describe_timeline(context, number, controller.situations.build_for_forecast())
    return JobData(
        describe_job(context, job),
        describe_farm(services).printers,
        list_history(context, None, None, _MAX_PRINTS),
        timeline,
        report,
        tuple(map_stored_files(controller.books, number)),
        time_curve_job,
        list_gcode_figures(job, controller.books.list_plates(job)),
    )


class _ChunkBuffer:
    """Writable stream without `seek`, which buffers the content until `take` is called."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []

    def write(self, content: bytes) -> int:
        """Append content."""
        self._chunks.append(bytes(content))
        return len(content)

    def flush(self) -> None:
        """Do nothing: `take` returns all content."""

    def take(self) -> bytes:
        """Return the buffered content, and remove it."""
        content = b"".join(self._chunks)
        self._chunks.clear()
        return content


def generate_archive(files: Mapping[str, Path]) -> Iterator[bytes]:
    """Yield the chunks of a ZIP archive of files.

    Parameters
    ----------
    files
        Paths of the files, by their names in the archive.

    Raises
    ------
    OSError
        If a file cannot be read; the content so far is not a valid archive.
    """
    buffer = _ChunkBuffer()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=_COMPRESSION_LEVEL) as archive:  # type: ignore[call-overload]
        for name, path in files.items():
            with path.open("rb") as source, archive.open(name, "w", force_zip64=True) as entry:
                while chunk := source.read(_CHUNK_BYTES):
                    entry.write(chunk)
                    yield buffer.take()
    yield buffer.take()
