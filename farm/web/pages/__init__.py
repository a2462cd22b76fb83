"""Pages for browsers, rendered on the server; scripts only add to them."""

from __future__ import annotations

from farm.web.pages.api_page import POLICY, render_api_page
from farm.web.pages.fleet import fleet_routes, printer_pages
from farm.web.pages.jobs import job_pages
from farm.web.pages.login_routes import login_routes
from farm.web.pages.page_context import PageContext
from farm.web.pages.rendering import load_pages, render_message
from farm.web.pages.routes import page_routes
from farm.web.pages.submit import SUBMIT_PATH, submit_routes

__all__ = [
    "POLICY",
    "SUBMIT_PATH",
    "PageContext",
    "fleet_routes",
    "job_pages",
    "load_pages",
    "login_routes",
    "page_routes",
    "printer_pages",
    "render_api_page",
    "render_message",
    "submit_routes",
]
