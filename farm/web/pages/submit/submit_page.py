"""Page with the form that submits a model, and its routes."""

from __future__ import annotations

import asyncio
import json
import re
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from starlette.exceptions import HTTPException

from decompose.files.extras import can_read_step
from decompose.options import MAX_PIN_MM, MIN_PIN_MM
from drivers.printers import PROFILES
from farm.config import Fleet, PrinterSection
from farm.control import JobCommands
from farm.errors import FarmError
from farm.http import CallerName
from farm.model import JobOptions
from farm.planning.inspection import resolve_filament
from farm.text import format_count
from farm.web.callers import find_holder
from farm.web.forms import FormReader, FormUploads
from farm.web.notes import Note, User
from farm.web.pages.page_context import PageContext
from farm.web.pages.page_route import PageRoute
from farm.web.pages.rendering import FleetInfo, render_page
from farm.web.pages.submit.options import DEFAULTS, QUALITIES, UNITS, read_job_options

SUBMIT_PATH = "/submit"
_MESH_SUFFIXES, _GCODE_SUFFIXES = ".stl,.3mf,.obj,.ply,.off", ".gcode,.gco,.g"
_STEP_SUFFIXES = ".step,.stp"
_SEE_OTHER, _BAD_REQUEST = 303, 400
_REQUEST_ID_PATTERN = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True, slots=True)
class SubmitChoices:
    """Choices in the form, which depend on the printers of the fleet.

    Attributes
    ----------
    printer_count
        Number of printers.
    materials, colours
        Kinds of material, and colours, of the reels on the printers.
    build_volumes_mm
        For each build volume: name of the printer model, width, depth and height.
    timezone
        Time zone of the times in the form.
    can_read_step
        True if the package for STEP files is installed.
    """

    printer_count: int
    materials: Sequence[str]
    colours: Sequence[str]
    build_volumes_mm: Sequence[tuple[str, float, float, float]]
    timezone: str
    can_read_step: bool = False


def list_choices(fleet: Fleet) -> SubmitChoices:
    """List the materials, colours and build volumes of the enabled printers, each once."""
    printers = [printer for printer in fleet.printers if printer.enabled]
    build_volumes_mm = {_describe_build_volume(printer) for printer in printers if printer.model in PROFILES}
    return SubmitChoices(
        printer_count=len(printers),
        materials=sorted({printer.material_kind or printer.material for printer in printers}),
        colours=sorted({printer.colour for printer in printers if printer.colour}),
        build_volumes_mm=sorted(build_volumes_mm),
        timezone=fleet.fleet.timezone,
        can_read_step=can_read_step(),
    )


def _describe_build_volume(section: PrinterSection) -> tuple[str, float, float, float]:
    profile = PROFILES[section.model]
    return profile.title, *(section.volume_mm or (*profile.bed_mm, profile.height_mm))


def render_submit_page(
    choices: SubmitChoices,
    request_id: str,
    fleet: FleetInfo,
    user: User,
    note: Note | None = None,
    values: Mapping[str, str] = DEFAULTS,
) -> str:
    """Render the page.

    Parameters
    ----------
    choices
        Choices in the form.
    request_id
        Id of the submission; a form that is sent twice creates only one job.
    fleet, user, note
        See `render_page`.
    values
        Values of the fields.
    """
    return render_page(
        "submit.html",
        fleet,
        SUBMIT_PATH,
        user,
        note,
        choices=choices,
        fleet_size=format_count(choices.printer_count, "printer"),
        request_id=request_id,
        values={**DEFAULTS, **values},
        units=UNITS,
        qualities=QUALITIES,
        min_pin_mm=MIN_PIN_MM,
        max_pin_mm=MAX_PIN_MM,
        build_volumes=json.dumps([list(volume) for volume in choices.build_volumes_mm]),
        file_types=",".join(
            (_MESH_SUFFIXES, *([_STEP_SUFFIXES] if choices.can_read_step else []), _GCODE_SUFFIXES)
        ),
    )


def make_submit_routes(pages: PageContext, jobs: JobCommands) -> APIRouter:
    """Return the routes that show the page and receive its form."""
    router, services = APIRouter(route_class=PageRoute, include_in_schema=False), pages.services
    fleet = services.controller.fleet
    uploads = FormUploads(services.uploads, jobs)

    def render(user: User, note: Note | None, values: dict[str, str] | None = None) -> str:
        choices = list_choices(services.controller.fleet)
        return render_submit_page(choices, uuid.uuid4().hex, fleet.fleet, user, note, values or DEFAULTS)

    async def render_empty_form(user: User, note: Note | None) -> str:
        return render(user, note)

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
            return HTMLResponse(render(User.for_holder(holder), Note(text, True), values), _BAD_REQUEST)
        remarks = jobs.list_unusable_options(services.controller.books.get_job(number).options)
        if remarks:
            pages.notes.put(holder.key.id, Note("; ".join(remarks)))
        return RedirectResponse(f"/jobs/{number}", _SEE_OTHER)

    return router
