"""Pages that are kept up to date in browsers, by server-sent events with what has changed."""

from __future__ import annotations

from farm.web.live.fragments import publish_page
from farm.web.live.live_pages import LivePages
from farm.web.live.live_route import live_routes

__all__ = ["LivePages", "live_routes", "publish_page"]
