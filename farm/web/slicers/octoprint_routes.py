"""Routes of OctoPrint's dialect, which PrusaSlicer, SuperSlicer, OrcaSlicer and a plugin of Cura speak."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

from fastapi import APIRouter, Request, Response

import farm
from farm.control import JobCommands
from farm.http import CallerName, Services
from farm.model import JobOptions
from farm.web.slicers.form_upload import submit_form
from farm.web.slicers.paths import FILES
from farm.web.slicers.text_errors import TextErrorRoute

_CREATED = 201


def octoprint_routes(services: Services, jobs: JobCommands) -> APIRouter:
    """Return the routes of OctoPrint's dialect."""
    router, controller = APIRouter(route_class=TextErrorRoute, include_in_schema=False), services.controller

    def read_target(request: Request) -> JobOptions:
        """Return the options of a job that is sent to this address. Raises NoSuchThing."""
        printer: str | None = request.path_params.get("printer")
        if printer is None:
            return JobOptions()
        controller.books.printer(printer)
        return JobOptions(only=(printer,))

    @router.get("/api/version")
    async def version(request: Request) -> dict[str, str]:
        read_target(request)
        return {"api": "0.1", "server": "1.9.0", "text": f"OctoPrint (farm {farm.__version__})"}

    @router.post(FILES, status_code=_CREATED)
    async def upload(request: Request, response: Response, by: CallerName) -> dict[str, Any]:
        submitted = await submit_form(request, services.uploads, jobs, read_target(request), by)
        path = f"{submitted.job}/{submitted.name}"
        location = f"{request.url.replace(query='', fragment='')}/{quote(path)}"
        response.headers["location"] = location
        held = controller.books.job(submitted.job).options.hold
        file = {"name": submitted.name, "path": path, "origin": "local", "refs": {"resource": location}}
        return {
            "files": {"local": file},
            "done": True,
            "effectiveSelect": False,
            "effectivePrint": submitted.print_requested and not held,
        }

    return router
