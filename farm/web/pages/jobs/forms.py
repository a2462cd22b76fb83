"""Routes of forms for the plan of a job that is not approved: to print it, to keep it, or to plan again."""

from __future__ import annotations

import uuid
from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from farm.control import JobCommands
from farm.errors import RefusedError
from farm.http import CallerName, Services, is_operator
from farm.web.actions import FormRoute, answer_form, read_form
from farm.web.notes import Note


class ReleaseForm(BaseModel):
    """Fields of the form that releases a job: hash of the plan that the user saw, None if there was none."""

    plan: str | None = None


class ReplanForm(BaseModel):
    """Fields of the form that plans a job again: number of printers, and job whose time curve is shown."""

    printers: Annotated[int, Field(ge=1)] | None = None
    curve: int | None = None


def make_plan_form_routes(services: Services, jobs: JobCommands) -> APIRouter:
    """Return the routes of the forms for plans."""
    router = APIRouter(route_class=FormRoute, include_in_schema=False)

    @router.post("/jobs/{number}/release")
    async def release_job(number: int, request: Request, caller_name: CallerName) -> Response:
        seen_plan = (await read_form(request, ReleaseForm)).plan
        plan = services.controller.books.get_job(number).plan
        if seen_plan is not None and seen_plan != plan:
            raise RefusedError(f"the plan of job {number} has changed: review it again")
        await jobs.release(number, services.state, caller_name, is_operator(request))
        return answer_form(request, Note(f"Job {number} will be printed as soon as possible."))

    @router.post("/jobs/{number}/keep")
    async def keep_plan(number: int, request: Request, caller_name: CallerName) -> Response:
        jobs.keep_dry_run(number, caller_name)
        return answer_form(request, Note(f"Job {number} is kept, and is printed once it is approved."))

    @router.post("/jobs/{number}/replan")
    async def replan_job(number: int, request: Request, caller_name: CallerName) -> Response:
        form = await read_form(request, ReplanForm)
        job = services.controller.books.get_job(number)
        options = job.options.model_copy(update={"printers": form.printers, "dry_run": True, "hold": True})
        new_number = jobs.resubmit(number, uuid.uuid4().hex, options, caller_name)
        if job.options.dry_run and not job.state.ended:
            jobs.cancel(number, caller_name)
        query = "" if form.curve is None else f"?curve={form.curve}"
        return answer_form(request, Note(f"Planned again as job {new_number}."), f"/jobs/{new_number}{query}")

    return router
