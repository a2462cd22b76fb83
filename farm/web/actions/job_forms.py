"""Routes of forms for jobs and their parts; they have the same paths and run the same commands as the API."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from farm import api
from farm.control import JobCommands, PartCommands
from farm.http import CallerName, OperatorName, Services
from farm.web.actions.form_route import FormRoute, answer_form, read_form
from farm.web.notes import Note


def make_job_form_routes(services: Services, jobs: JobCommands) -> APIRouter:
    """Return the routes of forms for jobs."""
    router = APIRouter(route_class=FormRoute, include_in_schema=False)

    @router.post("/jobs/{number}/approve")
    async def approve_job(number: int, request: Request, operator_name: OperatorName) -> Response:
        plan = (await read_form(request, api.ApproveRequest)).plan
        await jobs.approve(number, plan, services.state, operator_name)
        return answer_form(request, Note(f"Job {number} is approved."))

    @router.post("/jobs/{number}/move")
    async def move_job(number: int, request: Request, operator_name: OperatorName) -> Response:
        jobs.move(number, await read_form(request, api.QueueMove), operator_name)
        return answer_form(request, Note(f"Job {number} has moved in the queue."))

    @router.post("/jobs/{number}/start")
    async def reschedule_job(number: int, request: Request, operator_name: OperatorName) -> Response:
        at = (await read_form(request, api.JobStart)).at
        jobs.reschedule(number, at, operator_name)
        time_text = "as soon as it can" if at == "now" else f"not before {at}"
        return answer_form(request, Note(f"Job {number} starts {time_text}."))

    @router.post("/jobs/{number}/cancel")
    async def cancel_job(number: int, request: Request, caller_name: CallerName) -> Response:
        jobs.cancel(number, caller_name)
        return answer_form(request, Note(f"Job {number} is cancelled."))

    @router.post("/jobs/{number}/pause")
    async def pause_job(number: int, request: Request, caller_name: CallerName) -> Response:
        jobs.set_paused(number, True, caller_name)
        return answer_form(request, Note(f"Job {number} is paused."))

    @router.post("/jobs/{number}/resume")
    async def resume_job(number: int, request: Request, caller_name: CallerName) -> Response:
        jobs.set_paused(number, False, caller_name)
        return answer_form(request, Note(f"Job {number} continues."))

    @router.post("/jobs/{number}/assembled")
    async def record_assembly(number: int, request: Request, caller_name: CallerName) -> Response:
        minutes = (await read_form(request, api.AssembledRequest)).minutes
        jobs.record_assembly(number, minutes, caller_name)
        return answer_form(request, Note(f"Job {number} was assembled in {minutes:g} minutes."))

    return router


def make_part_form_routes(parts: PartCommands) -> APIRouter:
    """Return the routes of forms for a job's parts."""
    router = APIRouter(route_class=FormRoute, include_in_schema=False)

    @router.post("/jobs/{number}/parts/{part}/reprint")
    async def reprint_part(number: int, part: str, request: Request, caller_name: CallerName) -> Response:
        why = (await read_form(request, api.Reason)).why or "reprint requested"
        return answer_form(
            request, Note(f"Part {parts.reprint(number, part, why, caller_name)} is printed again.")
        )

    @router.post("/jobs/{number}/parts/{part}/cancel")
    async def cancel_part(number: int, part: str, request: Request, caller_name: CallerName) -> Response:
        return answer_form(request, Note(f"Part {parts.cancel(number, part, caller_name)} is cancelled."))

    @router.post("/jobs/{number}/parts/{part}/pause")
    async def pause_part(number: int, part: str, request: Request, caller_name: CallerName) -> Response:
        parts.set_paused(number, part, True, caller_name)
        return answer_form(request, Note(f"Part {part} is paused."))

    @router.post("/jobs/{number}/parts/{part}/resume")
    async def resume_part(number: int, part: str, request: Request, caller_name: CallerName) -> Response:
        parts.set_paused(number, part, False, caller_name)
        return answer_form(request, Note(f"Part {part} continues."))

    return router
