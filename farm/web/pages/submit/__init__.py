"""Page that submits a model, with the options of its job."""

from __future__ import annotations

from farm.web.pages.submit.submit_page import SUBMIT_PATH, make_submit_routes

__all__ = ["SUBMIT_PATH", "make_submit_routes"]
