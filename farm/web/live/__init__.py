"""Live pages: server-sent events update the changed elements of a page in the browser."""

from __future__ import annotations

from farm.web.live.fragments import prepare_page
from farm.web.live.live_pages import LivePages, make_live_routes

__all__ = ["LivePages", "make_live_routes", "prepare_page"]
