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
        What was looked at: a fixed name, for programs.
    level
        How bad it is.
    text
        What was found, with where.
    action
        What to do; empty where nothing has to be done.
    """

    check: str
    level: Level
    text: str
    action: str = ""


def passed(check: str, text: str) -> Finding:
    """Return a finding where all is well."""
    return Finding(check, Level.OK, text)


def warning(check: str, text: str, action: str) -> Finding:
    """Return a finding that the farm works with, or may stumble over."""
    return Finding(check, Level.WARNING, text, action)


def problem(check: str, text: str, action: str) -> Finding:
    """Return a finding that keeps the farm from working."""
    return Finding(check, Level.PROBLEM, text, action)
