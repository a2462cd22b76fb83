"""Result of one check. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of a check.

    Attributes
    ----------
    check
        Name of the check; a stable identifier for programs.
    level
        Severity.
    text
        The finding, with the file, printer or port concerned.
    action
        Instruction for the user; empty if there is nothing to do.
    """

    check: str
    level: Level
    text: str
    action: str = ""


def make_success(check: str, text: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(check, Level.OK, text)


def make_warning(check: str, text: str, action: str) -> Finding:
    """Return a finding about a fault that may cause problems, though the farm works."""
    return Finding(check, Level.WARNING, text, action)


def make_problem(check: str, text: str, action: str) -> Finding:
    """Return a finding about a fault that keeps the farm from working."""
    return Finding(check, Level.PROBLEM, text, action)
