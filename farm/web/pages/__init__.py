"""Pages for browsers, rendered on the server; scripts only add to them."""

from __future__ import annotations

from farm.web.pages.api_page import POLICY, render_api_page
from farm.web.pages.fleet import make_history_routes, make_printer_page_routes, make_timeline_routes
from farm.web.pages.home import make_home_routes
from farm.web.pages.jobs import make_all_job_routes
from farm.web.pages.login_routes import make_login_routes
from farm.web.pages.page_context import PageContext
from farm.web.pages.rendering import load_page_files, render_message
from farm.web.pages.static_files import make_static_routes
from farm.web.pages.submit import SUBMIT_PATH, make_submit_routes

__all__ = [
    "POLICY",
    "SUBMIT_PATH",
    "PageContext",
    "load_page_files",
    "make_all_job_routes",
    "make_history_routes",
    "make_home_routes",
    "make_login_routes",
    "make_printer_page_routes",
    "make_static_routes",
    "make_submit_routes",
    "make_timeline_routes",
    "render_api_page",
    "render_message",
]
