"""Routes of printers: beds, reels, prints, maintenance, agents, cameras."""

from __future__ import annotations

from fastapi import APIRouter, Response

from farm import api
from farm.control import PartCommands, PrinterCommands
from farm.errors import RefusedError
from farm.http.callers import CallerName, OperatorName
from farm.http.services import Services

_IMAGES = {media_type: {"schema": {"type": "string"}} for media_type in ("image/jpeg", "image/png")}


def make_printer_routes(services: Services, printers: PrinterCommands, parts: PartCommands) -> APIRouter:
    """Return the routes of printers."""
    router = APIRouter()

    @router.post("/printers/{name}/cleared")
    async def clear_bed(
        name: str, request: api.ClearedRequest, operator_name: OperatorName
    ) -> api.ClearedResponse:
        return printers.clear_bed(name, request, operator_name)

    @router.post("/printers/{name}/load")
    async def load_reel(name: str, request: api.LoadRequest, operator_name: OperatorName) -> api.Reel:
        reel = await printers.load_reel(name, request, operator_name)
        return api.Reel(**reel.model_dump(exclude={"uncertain"}))

    @router.post("/printers/{name}/pause")
    async def pause_printer(name: str, caller_name: CallerName) -> None:
        printers.set_paused(name, True, caller_name)

    @router.post("/printers/{name}/resume")
    async def resume_printer(name: str, caller_name: CallerName) -> None:
        printers.set_paused(name, False, caller_name)

    @router.post("/printers/{name}/fail")
    async def fail_print(name: str, request: api.Reason, caller_name: CallerName) -> None:
        printers.fail_print(name, request.why or "failed by a user", caller_name)

    @router.post("/printers/{name}/cancel")
    async def cancel_print(name: str, caller_name: CallerName) -> api.NameResponse:
        return api.NameResponse(name=parts.cancel_on_printer(name, caller_name))

    @router.post("/printers/{name}/maintenance")
    async def begin_maintenance(name: str, request: api.Reason, caller_name: CallerName) -> None:
        printers.begin_maintenance(name, request.why, caller_name)

    @router.post("/printers/{name}/maintained")
    async def end_maintenance(name: str, operator_name: OperatorName) -> None:
        printers.end_maintenance(name, operator_name)

    @router.post("/printers/{name}/replace")
    async def replace_agent(name: str, operator_name: OperatorName) -> None:
        if services.controller.books.find_open_print(name) is not None:
            raise RefusedError(f"{name} is printing: replace its agent after the print has ended")
        await services.replace_agent(name)

    @router.post("/outage/confirm")
    async def confirm_outage(operator_name: OperatorName) -> api.NameResponse:
        return api.NameResponse(name=printers.confirm_outage(operator_name))

    return router


def make_camera_routes(services: Services) -> APIRouter:
    """Return the route of the printers' cameras."""
    router = APIRouter()

    @router.get(
        "/printers/{name}/camera",
        response_class=Response,
        responses={
            200: {"description": "A picture by the camera, at most two seconds old.", "content": _IMAGES},
            503: {"description": "The camera sends no picture.", "model": api.Problem},
        },
    )
    async def send_still(name: str) -> Response:
        image = await services.fetch_still(name)
        return Response(image.content, media_type=image.media_type, headers={"cache-control": "no-store"})

    return router
