"""Routes that submit models and report the progress of uploads."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Query, Request

from farm import api
from farm.control import JobCommands
from farm.http.callers import CallerName
from farm.http.services import Services
from farm.http.uploads import clean_name, parse_options
from farm.planning.inspection import resolve_filament

_MODEL_BODY = {
    "required": True,
    "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
}


def make_upload_routes(services: Services, jobs: JobCommands) -> APIRouter:
    """Return the routes that submit models and report the progress of uploads."""
    router, uploads = APIRouter(), services.uploads

    @router.post("/jobs", response_model_exclude_defaults=True, openapi_extra={"requestBody": _MODEL_BODY})
    async def submit_model(
        request: Request,
        request_id: Annotated[str, Query(min_length=8, max_length=64)],
        name: Annotated[str, Query(min_length=1, max_length=200)],
        size: Annotated[int, Query(ge=0)],
        caller_name: CallerName,
        options: str = "{}",
    ) -> api.SubmitResponse:
        job_options = parse_options(options)
        earlier_job = jobs.find_submission(request_id)
        if earlier_job is not None:
            return api.SubmitResponse(job=earlier_job, again=True)
        jobs.check_submission(job_options)
        fleet = services.controller.fleet
        job_options = await asyncio.to_thread(
            resolve_filament, job_options, fleet.printers, fleet.fleet.materials
        )
        name = clean_name(name)
        model = await uploads.receive_model(request.stream(), request_id, name, size, job_options)
        number, is_repeated = jobs.submit(request_id, name, model, job_options, caller_name)
        return api.SubmitResponse(
            job=number, again=is_repeated, notices=jobs.list_unusable_options(job_options)
        )

    @router.get("/uploads/{request_id}")
    async def show_upload(request_id: str) -> api.UploadView:
        return uploads.describe(request_id)

    return router
