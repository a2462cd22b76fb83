"""Page that submits a model, with the options of its job."""

from __future__ import annotations

from farm.web.pages.submit.routes import make_submit_routes
from farm.web.pages.submit.submit_page import SUBMIT_PATH

__all__ = ["SUBMIT_PATH", "make_submit_routes"]
