"""Pages of jobs, with their plans, parts and files."""

from __future__ import annotations

from fastapi import APIRouter

from farm.control import DryRuns, JobCommands
from farm.web.pages.jobs.forms import make_plan_form_routes
from farm.web.pages.jobs.routes import make_job_page_routes
from farm.web.pages.page_context import PageContext

__all__ = ["make_all_job_routes"]


def make_all_job_routes(pages: PageContext, jobs: JobCommands, dry_runs: DryRuns) -> APIRouter:
    """Return the routes of all pages of jobs, and of the forms for their plans."""
    router = APIRouter(include_in_schema=False)
    router.include_router(make_job_page_routes(pages, dry_runs))
    router.include_router(make_plan_form_routes(pages.services, jobs))
    return router
