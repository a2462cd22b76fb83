"""Errors of the printer drivers, one root for the package."""

from __future__ import annotations


class DriverError(Exception):
    """Anything that a driver reports; the message says what, where, and what to do."""


class PortError(DriverError):
    """A port cannot be opened, is taken, or went away."""


class AgentError(DriverError):
    """An agent refused a request or cannot be reached."""


class MessageError(DriverError):
    """A message on an agent's socket that is not one of ours."""
