"""Pages of jobs: their plans, parts and files."""

from __future__ import annotations

from fastapi import APIRouter

from farm.control import DryRuns, JobCommands
from farm.http import Services
from farm.web.live import LivePages
from farm.web.notes import Notes
from farm.web.pages.jobs.forms import plan_forms
from farm.web.pages.jobs.routes import job_page_routes

__all__ = ["job_pages"]


def job_pages(
    services: Services, jobs: JobCommands, dry_runs: DryRuns, notes: Notes, live: LivePages
) -> APIRouter:
    """Return the routes of all pages of jobs, and of their forms.

    Parameters
    ----------
    services, jobs, dry_runs
        Components of the daemon.
    notes
        Notes to show above the pages.
    live
        Receives the pages that are kept up to date.
    """
    router = APIRouter(include_in_schema=False)
    router.include_router(job_page_routes(services, dry_runs, notes, live))
    router.include_router(plan_forms(services, jobs))
    return router
