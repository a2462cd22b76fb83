"""Notices for the user on stderr."""

from __future__ import annotations

import sys


def print_notice(line: str) -> None:
    """Print one line for the user on stderr."""
    print(f"farm: {line}", file=sys.stderr)
