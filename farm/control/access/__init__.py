"""Access from the network: keys of programs, requests for these keys, and sessions of browsers."""

from __future__ import annotations

from farm.control.access.app_key_requests import AppKeyRequests
from farm.control.access.keys import KeyCommands, find_key
from farm.control.access.sessions import LINK_LIFETIME_S, MAX_SESSION_S, SessionCommands

__all__ = ["LINK_LIFETIME_S", "MAX_SESSION_S", "AppKeyRequests", "KeyCommands", "SessionCommands", "find_key"]
