"""Pages of jobs: their plans, parts and files."""

from __future__ import annotations

from fastapi import APIRouter

from farm.control import DryRuns, JobCommands
from farm.web.pages.jobs.forms import plan_forms
from farm.web.pages.jobs.routes import job_page_routes
from farm.web.pages.page_context import PageContext

__all__ = ["job_pages"]


def job_pages(pages: PageContext, jobs: JobCommands, dry_runs: DryRuns) -> APIRouter:
    """Return the routes of all pages of jobs, and of their forms."""
    router = APIRouter(include_in_schema=False)
    router.include_router(job_page_routes(pages, dry_runs))
    router.include_router(plan_forms(pages.services, jobs))
    return router
