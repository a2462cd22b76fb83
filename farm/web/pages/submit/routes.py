"""Routes of the page that submits a model."""

from __future__ import annotations

import asyncio
import re
import uuid

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from starlette.exceptions import HTTPException

from farm.control import JobCommands
from farm.errors import FarmError
from farm.http import CallerName
from farm.model import JobOptions
from farm.planning.inspection import resolve_filament
from farm.web.callers import find_holder
from farm.web.forms import FormReader, FormUploads
from farm.web.notes import Note, Reader
from farm.web.pages.page_context import PageContext
from farm.web.pages.page_route import PageRoute
from farm.web.pages.submit.options import DEFAULTS, read_job_options
from farm.web.pages.submit.submit_page import SUBMIT_PATH, list_choices, render_submit_page

_SEE_OTHER, _BAD_REQUEST = 303, 400
_REQUEST_ID_PATTERN = re.compile(r"[0-9a-f]{32}")


def make_submit_routes(pages: PageContext, jobs: JobCommands) -> APIRouter:
    """Return the routes of the page."""
    router, services = APIRouter(route_class=PageRoute, include_in_schema=False), pages.services
    fleet = services.controller.fleet
    uploads = FormUploads(services.uploads, jobs)

    def render(reader: Reader, note: Note | None, values: dict[str, str] | None = None) -> str:
        choices = list_choices(services.controller.fleet)
        return render_submit_page(choices, uuid.uuid4().hex, fleet.fleet, reader, note, values or DEFAULTS)

    async def render_empty_form(reader: Reader, note: Note | None) -> str:
        return render(reader, note)

    @router.get(SUBMIT_PATH)
    async def show_form(request: Request) -> Response:
        return await pages.answer(request, render_empty_form)

    @router.post(SUBMIT_PATH)
    async def submit_model(request: Request, caller_name: CallerName) -> Response:
        holder, values = find_holder(request), dict[str, str]()

        async def read_options(form: FormReader) -> JobOptions:
            values.update({name: form.fields[name] for name in DEFAULTS if name in form.fields})
            options = read_job_options(form.fields)
            return await asyncio.to_thread(resolve_filament, options, fleet.printers, fleet.fleet.materials)

        given_id = request.query_params.get("request", "")
        request_id = given_id if _REQUEST_ID_PATTERN.fullmatch(given_id) else uuid.uuid4().hex
        earlier_job = jobs.find_submission(request_id)
        if earlier_job is not None:
            return RedirectResponse(f"/jobs/{earlier_job}", _SEE_OTHER)
        try:
            number = (await uploads.submit(request, request_id, read_options, caller_name)).job_number
        except (FarmError, HTTPException) as error:
            text = str(error.detail if isinstance(error, HTTPException) else error)
            return HTMLResponse(render(Reader.for_holder(holder), Note(text, True), values), _BAD_REQUEST)
        remarks = jobs.list_unusable_options(services.controller.books.get_job(number).options)
        if remarks:
            pages.notes.put(holder.key.id, Note("; ".join(remarks)))
        return RedirectResponse(f"/jobs/{number}", _SEE_OTHER)

    return router
