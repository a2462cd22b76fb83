"""Routes of jobs, of their queue and of their parts."""

from __future__ import annotations

import time

from fastapi import APIRouter

from farm import api
from farm.control import DryRuns, JobCommands, PartCommands
from farm.http.callers import CallerName, OperatorName
from farm.http.services import Services
from farm.views import describe_job, describe_timeline
from farm.views.jobs import describe_queue


def make_job_routes(services: Services, jobs: JobCommands, dry_runs: DryRuns) -> APIRouter:
    """Return the routes of jobs."""
    router, controller = APIRouter(), services.controller

    @router.get("/jobs/{number}")
    async def show_job(number: int) -> api.JobStatus:
        dry_runs.keep(number, time.monotonic())
        context = controller.build_view_context(services.state)
        return api.JobStatus(
            daemon=services.describe_daemon(context),
            job=describe_job(context, controller.books.get_job(number)),
        )

    @router.get("/jobs/{number}/timeline")
    async def show_timeline(number: int) -> api.Timeline:
        context = controller.build_view_context(services.state)
        return describe_timeline(context, number, controller.situations.build_for_forecast())

    @router.post("/jobs/{number}/approve")
    async def approve_job(number: int, request: api.ApproveRequest, operator_name: OperatorName) -> None:
        await jobs.approve(number, request.plan, services.state, operator_name)

    @router.post("/jobs/{number}/assembled")
    async def record_assembly(
        number: int, request: api.AssembledRequest, caller_name: CallerName
    ) -> api.JobStatus:
        jobs.record_assembly(number, request.minutes, caller_name)
        return await show_job(number)

    @router.post("/jobs/{number}/start")
    async def reschedule_job(
        number: int, request: api.JobStart, operator_name: OperatorName
    ) -> api.JobStatus:
        jobs.reschedule(number, request.at, operator_name)
        return await show_job(number)

    @router.post("/jobs/{number}/cancel")
    async def cancel_job(number: int, caller_name: CallerName) -> api.JobStatus:
        jobs.cancel(number, caller_name)
        return await show_job(number)

    @router.post("/jobs/{number}/pause")
    async def pause_job(number: int, caller_name: CallerName) -> None:
        jobs.set_paused(number, True, caller_name)

    @router.post("/jobs/{number}/resume")
    async def resume_job(number: int, caller_name: CallerName) -> None:
        jobs.set_paused(number, False, caller_name)

    return router


def make_queue_routes(services: Services, jobs: JobCommands) -> APIRouter:
    """Return the routes of the queue."""
    router, controller = APIRouter(), services.controller

    @router.get("/queue")
    async def show_queue() -> api.Queue:
        return describe_queue(controller.build_view_context(services.state))

    @router.post("/jobs/{number}/move")
    async def move_job(number: int, request: api.QueueMove, operator_name: OperatorName) -> api.Queue:
        jobs.move(number, request, operator_name)
        return await show_queue()

    return router


def make_part_routes(parts: PartCommands) -> APIRouter:
    """Return the routes of a job's parts."""
    router = APIRouter()

    @router.post("/jobs/{number}/parts/{part}/reprint")
    async def reprint_part(
        number: int, part: str, request: api.Reason, caller_name: CallerName
    ) -> api.NameResponse:
        return api.NameResponse(
            name=parts.reprint(number, part, request.why or "reprint requested", caller_name)
        )

    @router.post("/jobs/{number}/parts/{part}/cancel")
    async def cancel_part(number: int, part: str, caller_name: CallerName) -> api.NameResponse:
        return api.NameResponse(name=parts.cancel(number, part, caller_name))

    @router.post("/jobs/{number}/parts/{part}/pause")
    async def pause_part(number: int, part: str, caller_name: CallerName) -> api.NameResponse:
        return api.NameResponse(name=parts.set_paused(number, part, True, caller_name))

    @router.post("/jobs/{number}/parts/{part}/resume")
    async def resume_part(number: int, part: str, caller_name: CallerName) -> api.NameResponse:
        return api.NameResponse(name=parts.set_paused(number, part, False, caller_name))

    return router
