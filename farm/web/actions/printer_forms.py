"""Routes of forms for printers; they have the same paths and run the same commands as the API."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from farm import api
from farm.control import PartCommands, PrinterCommands
from farm.http import CallerName, OperatorName
from farm.web.actions.form_route import FormRoute, answer_form, read_form
from farm.web.notes import Note
from farm.wording import describe_material


def make_printer_form_routes(printers: PrinterCommands) -> APIRouter:
    """Return the routes of forms for printers."""
    router = APIRouter(route_class=FormRoute, include_in_schema=False)

    @router.post("/printers/{name}/cleared")
    async def clear_bed(name: str, request: Request, operator_name: OperatorName) -> Response:
        response = printers.clear_bed(name, await read_form(request, api.ClearedRequest), operator_name)
        return answer_form(request, Note(describe_cleared_bed(name, response)))

    @router.post("/printers/{name}/load")
    async def load_reel(name: str, request: Request, operator_name: OperatorName) -> Response:
        reel = await printers.load_reel(name, await read_form(request, api.LoadRequest), operator_name)
        grams = "" if reel.grams is None else f", {reel.grams:.0f} g"
        colour = f" {reel.colour}" if reel.colour else ""
        return answer_form(
            request, Note(f"{name} has {describe_material(reel.material, reel.kind)}{colour}{grams}.")
        )

    @router.post("/printers/{name}/maintenance")
    async def begin_maintenance(name: str, request: Request, caller_name: CallerName) -> Response:
        printers.begin_maintenance(name, (await read_form(request, api.Reason)).why, caller_name)
        return answer_form(request, Note(f"{name} takes no further plates."))

    @router.post("/printers/{name}/maintained")
    async def end_maintenance(name: str, request: Request, operator_name: OperatorName) -> Response:
        printers.end_maintenance(name, operator_name)
        return answer_form(request, Note(f"{name} is back in use."))

    @router.post("/outage/confirm")
    async def confirm_outage(request: Request, operator_name: OperatorName) -> Response:
        return answer_form(request, Note(f"{printers.confirm_outage(operator_name)} may print again."))

    return router


def make_print_form_routes(printers: PrinterCommands, parts: PartCommands) -> APIRouter:
    """Return the routes of forms for the print on a printer."""
    router = APIRouter(route_class=FormRoute, include_in_schema=False)

    @router.post("/printers/{name}/pause")
    async def pause_printer(name: str, request: Request, caller_name: CallerName) -> Response:
        printers.set_paused(name, True, caller_name)
        return answer_form(request, Note(f"{name} pauses."))

    @router.post("/printers/{name}/resume")
    async def resume_printer(name: str, request: Request, caller_name: CallerName) -> Response:
        printers.set_paused(name, False, caller_name)
        return answer_form(request, Note(f"{name} resumes."))

    @router.post("/printers/{name}/fail")
    async def fail_print(name: str, request: Request, caller_name: CallerName) -> Response:
        reason = await read_form(request, api.Reason)
        printers.fail_print(name, reason.why or "failed by a user", caller_name)
        return answer_form(request, Note(f"The print on {name} is stopped, and its part is printed again."))

    @router.post("/printers/{name}/cancel")
    async def cancel_print(name: str, request: Request, caller_name: CallerName) -> Response:
        part = parts.cancel_on_printer(name, caller_name)
        return answer_form(request, Note(f"Part {part} on {name} is cancelled."))

    return router


def describe_cleared_bed(printer: str, response: api.ClearedResponse) -> str:
    """Return a sentence that describes the result of a report that a bed is clear."""
    if response.good is not None:
        reprints = "".join(f"; {name} is already printing it again" for name in response.printed_on)
        return f"{printer} is clear, and part {response.good} is good{reprints}."
    return f"{printer} is clear" + (f"; part {response.again} is printed again." if response.again else ".")
