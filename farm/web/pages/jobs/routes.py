"""Routes of a job's page, its instructions and its report."""

from __future__ import annotations

import asyncio
import time
from datetime import datetime
from functools import lru_cache
from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from farm import api
from farm.control import READING_S, DryRuns
from farm.errors import NoSuchThing
from farm.http import Services, describe_farm, find_stored_file, name_stored_files
from farm.views import describe_job, describe_timeline, list_history
from farm.views.decomposition_report import Report, parse_report
from farm.views.report import list_figures, render_page
from farm.web.callers import find_holder
from farm.web.live import LivePages, publish_page
from farm.web.notes import Note, Notes, Reader
from farm.web.pages.jobs.job_page import JobData, render_job_page
from farm.web.pages.page_route import PageRoute

_INSTRUCTIONS, _PICTURE, _REPORT = "instructions.html", "assembly.png", "decomposition.json"
_DOCUMENT = {
    "content-security-policy": "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
    "frame-ancestors 'none'; base-uri 'none'"
}
"""Policy of a page that the farm wrote as one file: its own style and pictures, and no script."""
_MAX_PRINTS = 2000  # of other jobs, in a timeline


def job_page_routes(services: Services, dry_runs: DryRuns, notes: Notes, live: LivePages) -> APIRouter:
    """Return the routes.

    Parameters
    ----------
    services
        Components of the daemon.
    dry_runs
        Kept alive by pages that show them.
    notes
        Notes to show above the pages.
    live
        Receives the page, to keep it up to date.
    """
    router, controller = APIRouter(route_class=PageRoute, include_in_schema=False), services.controller
    farm = controller.fleet.fleet.name

    def read_stored_report(number: int) -> Report:
        stored = name_stored_files(controller.books, number).get(_REPORT)
        try:
            return Report() if stored is None else _read_report(services.state.files / stored)
        except OSError:  # the page shows the rest
            return Report()

    def show(reader: Reader, number: str, note: Note | None = None, curve: int | None = None) -> str:
        report = read_stored_report(int(number))
        if curve is not None and not report.curve:
            report = report.model_copy(update={"curve": read_stored_report(curve).curve})
        data = describe_job_page(services, int(number), report, curve)
        return render_job_page(data, farm, reader, note)

    def show_live(reader: Reader, number: str) -> str:
        if not number.isdecimal():
            raise NoSuchThing(f"there is no job {number}")
        return show(reader, number)

    live.add("/jobs/{number}", show_live)

    @router.get("/jobs/{number}")
    async def show_job(number: int, request: Request, curve: int | None = None) -> Response:
        holder = find_holder(request)
        dry_runs.keep(number, time.monotonic(), READING_S)
        page = show(Reader.for_holder(holder), str(number), notes.take(holder.key.id), curve)
        return HTMLResponse(publish_page(page))

    @router.get("/jobs/{number}/instructions")
    async def show_instructions(number: int) -> Response:
        path = await find_stored_file(services, number, _INSTRUCTIONS)
        return FileResponse(path, media_type="text/html", headers=_DOCUMENT)

    @router.get("/jobs/{number}/report")
    async def show_report(number: int) -> Response:
        context = controller.build_view_context(services.state)
        job = describe_job(context, controller.books.job(number))
        others = list_history(context, None, None, _MAX_PRINTS)
        try:
            path = await find_stored_file(services, number, _PICTURE)
            picture = await asyncio.to_thread(path.read_bytes)
        except (NoSuchThing, OSError):
            picture = None
        now = datetime.fromtimestamp(context.now_s, controller.fleet.zone)
        page = render_page(job, others, now, list_figures(job), {}, picture, read_stored_report(number))
        return HTMLResponse(page, headers=_DOCUMENT)

    return router


@lru_cache(maxsize=32)
def _read_report(path: Path) -> Report:
    """Read a report; a stored file never changes, and a page that is kept up to date shows it again.

    Raises
    ------
    OSError
        If it cannot be read; that is not cached, as it may pass.
    """
    return parse_report(path.read_bytes())


def describe_job_page(services: Services, number: int, report: Report, curve_job: int | None) -> JobData:
    """Collect the data of a job's page. Raises NoSuchThing for an unknown job."""
    controller = services.controller
    context = controller.build_view_context(services.state)
    job = controller.books.job(number)
    timeline: api.Timeline | None = None
    if job.plates and not job.state.ended:
        timeline = describe_timeline(context, number, controller.expected_situation())
    return JobData(
        describe_job(context, job),
        describe_farm(services).printers,
        list_history(context, None, None, _MAX_PRINTS),
        timeline,
        report,
        tuple(name_stored_files(controller.books, number)),
        curve_job,
    )
