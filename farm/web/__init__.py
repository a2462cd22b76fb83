"""The daemon's second server, for callers on the network, who identify themselves by keys or sessions."""

from __future__ import annotations

from farm.web.app import make_web_app
from farm.web.server import NetworkServer, find_host_names, has_valid_key

__all__ = ["NetworkServer", "find_host_names", "has_valid_key", "make_web_app"]
