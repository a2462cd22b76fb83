"""Routes of the OctoPrint API, which PrusaSlicer, SuperSlicer, OrcaSlicer and a Cura plugin use."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

from fastapi import APIRouter, Request, Response

from farm import api
from farm.control import JobCommands
from farm.http import CallerName, Services, identify_caller, is_operator
from farm.model import Job
from farm.views import describe_printer
from farm.web.slicers import octoprint_views as views
from farm.web.slicers.address import Address, AddressParameter
from farm.web.slicers.form_upload import submit_form
from farm.web.slicers.paths import FILE_PATH, FILES_PATH, JOB_FILE_PATH
from farm.web.slicers.selection import Selection
from farm.web.slicers.text_errors import TextErrorRoute

_CREATED = 201


def make_octoprint_routes(services: Services, jobs: JobCommands, selection: Selection) -> APIRouter:
    """Return the routes of the OctoPrint API that describe the farm or receive uploads.

    Parameters
    ----------
    services, jobs
        Components of the daemon.
    selection
        Jobs that callers have selected.
    """
    router = APIRouter(route_class=TextErrorRoute, include_in_schema=False)
    controller = services.controller
    _add_description_routes(router, services)
    _add_file_routes(router, services)

    @router.get("/api/job")
    async def show_job(address: AddressParameter, caller_name: CallerName) -> dict[str, Any]:
        current_job = selection.find(caller_name, address, controller.books)
        prints = controller.books.list_open_prints(current_job.id) if current_job is not None else ()
        printer = next(
            (attempt.printer for attempt in prints if address.printer in (None, attempt.printer)), None
        )
        view = None if printer is None else _describe_printer(services, printer)
        return views.describe_current_job(current_job, view.print if view else None)

    @router.post(FILES_PATH, status_code=_CREATED)
    async def receive_upload(
        request: Request, response: Response, address: AddressParameter, caller_name: CallerName
    ) -> dict[str, Any]:
        slicer_upload = await submit_form(request, services.uploads, jobs, address.options, caller_name)
        job = controller.books.get_job(slicer_upload.job_number)
        response.headers["location"] = location = _make_file_url(address, job)
        file = {"name": job.name, "path": views.format_file_path(job), "origin": "local"}
        return {
            "files": {"local": {**file, "refs": {"resource": location}}},
            "done": True,
            "effectiveSelect": False,
            "effectivePrint": slicer_upload.is_print_requested and not job.options.hold,
        }

    return router


def _add_description_routes(router: APIRouter, services: Services) -> None:
    """Add the routes that describe the caller, and the farm or a printer."""
    controller = services.controller

    @router.get("/api/version")
    async def show_version(_: AddressParameter) -> dict[str, Any]:
        return views.describe_version()

    @router.get("/api/server")
    async def show_server(_: AddressParameter) -> dict[str, Any]:
        return {"version": views.SERVER_VERSION, "safemode": None}

    @router.get("/api/settings")
    async def show_settings(address: AddressParameter) -> dict[str, Any]:
        return views.describe_settings(address.find_name(controller))

    @router.get("/api/printer")
    async def show_printer(address: AddressParameter) -> dict[str, Any]:
        name = address.printer
        return views.describe_state(None if name is None else _describe_printer(services, name))

    @router.get("/api/printerprofiles")
    async def show_profiles(address: AddressParameter) -> dict[str, Any]:
        resource = f"{address.root}/api/printerprofiles"
        return views.describe_profiles(
            address.find_name(controller), address.list_sections(controller), resource
        )

    @router.get("/api/connection")
    async def show_connection(address: AddressParameter) -> dict[str, Any]:
        return views.describe_connection(address.find_name(controller))

    @router.get("/api/currentuser")
    async def show_current_user(request: Request, _: AddressParameter) -> dict[str, Any]:
        caller = identify_caller(request)
        return views.describe_user(caller.name, is_operator(request))

    @router.post("/api/login")
    async def log_in(request: Request, _: AddressParameter) -> dict[str, Any]:
        caller = identify_caller(request)
        return views.describe_login(caller.name, is_operator(request))


def _add_file_routes(router: APIRouter, services: Services) -> None:
    """Add the routes that describe the files of jobs."""
    controller = services.controller

    @router.get("/api/files")
    @router.get(FILES_PATH)
    async def list_files(address: AddressParameter) -> dict[str, Any]:
        open_jobs = [job for job in controller.books.list_open_jobs() if address.lists_job(job)]
        return {"files": [views.describe_file(job, _make_file_url(address, job)) for job in open_jobs]}

    @router.get(FILE_PATH)
    @router.get(JOB_FILE_PATH)
    async def show_file(
        address: AddressParameter, caller_name: CallerName, name: str, number: str = ""
    ) -> dict[str, Any]:
        job = views.find_job(controller.books.jobs, f"{number}/{name}", caller_name)
        return views.describe_file(job, _make_file_url(address, job))


def _describe_printer(services: Services, name: str) -> api.PrinterView:
    controller = services.controller
    section = controller.fleet.find_printer(name)
    return describe_printer(controller.build_view_context(services.state), section, None)


def _make_file_url(address: Address, job: Job) -> str:
    """Return the URL of a job's file."""
    return f"{address.root}{FILES_PATH}/{quote(views.format_file_path(job))}"
