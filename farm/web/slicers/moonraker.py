"""Routes of the Moonraker API that slicers use: to test the connection, and to upload files.

As in Moonraker, the response to an upload is not wrapped in `result`, unlike all other responses.
"""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

from fastapi import APIRouter, Request, Response

import farm
from farm.control import JobCommands
from farm.http import CallerName, Services
from farm.web.slicers.address import AddressParameter
from farm.web.slicers.form_upload import submit_form
from farm.web.slicers.octoprint_views import format_file_path
from farm.web.slicers.paths import MOONRAKER_UPLOAD_PATH
from farm.web.slicers.text_errors import TextErrorRoute

_CREATED = 201
_ROOT = "gcodes"
_READY_STATE = "ready"


def make_moonraker_routes(services: Services, jobs: JobCommands) -> APIRouter:
    """Return the routes of the Moonraker API."""
    router = APIRouter(route_class=TextErrorRoute, include_in_schema=False)
    controller = services.controller

    @router.get("/server/info")
    async def describe_server(_: AddressParameter) -> dict[str, Any]:
        components = {"components": ["file_manager"], "failed_components": [], "warnings": []}
        state = {"klippy_connected": True, "klippy_state": _READY_STATE, "registered_directories": [_ROOT]}
        version = {"moonraker_version": f"farm {farm.__version__}", "api_version": [1, 4, 0]}
        return {"result": {**state, **components, **version}}

    @router.get("/printer/info")
    async def describe_printer(address: AddressParameter) -> dict[str, Any]:
        state = {"state": _READY_STATE, "state_message": "Printer is ready"}
        names = {"hostname": address.find_name(controller), "software_version": f"farm {farm.__version__}"}
        return {"result": {**state, **names}}

    @router.post(MOONRAKER_UPLOAD_PATH, status_code=_CREATED)
    async def receive_upload(
        request: Request, response: Response, address: AddressParameter, caller_name: CallerName
    ) -> dict[str, Any]:
        slicer_upload = await submit_form(request, services.uploads, jobs, address.options, caller_name)
        job = controller.books.get_job(slicer_upload.job_number)
        path = format_file_path(job)
        response.headers["location"] = f"{address.root}/server/files/{_ROOT}/{quote(path)}"
        is_queued = slicer_upload.is_print_requested and not job.options.hold
        item = {"path": path, "root": _ROOT}
        return {"item": item, "print_started": False, "print_queued": is_queued, "action": "create_file"}

    return router
