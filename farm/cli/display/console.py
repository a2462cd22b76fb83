"""Consoles, styles and JSON of the CLI. Texts from users and printers are never parsed as markup."""

from __future__ import annotations

import json
import sys
from typing import Any

from pydantic import BaseModel
from rich.console import Console

HEADING_STYLE = "bold"
URGENT_STYLE = "bold red"
ERROR_STYLE = "red"
WARNING_STYLE = "yellow"
NOTE_STYLE = "dim"

_PIPE_WIDTH = 200  # columns


def open_console(stderr: bool = False) -> Console:
    """Open a console as wide as the terminal, or `_PIPE_WIDTH` columns for a file or a pipe."""
    width = None if (sys.stderr if stderr else sys.stdout).isatty() else _PIPE_WIDTH
    return Console(stderr=stderr, highlight=False, markup=False, soft_wrap=True, width=width)


def read_terminal_width(screen: Console) -> int | None:
    """Return the width of a terminal in columns; None for a file or a pipe, whose lines are not wrapped."""
    return screen.width if screen.is_terminal else None


def print_json(content: BaseModel | dict[str, Any]) -> None:
    """Print one JSON object on stdout."""
    if isinstance(content, BaseModel):
        print(content.model_dump_json(by_alias=True, indent=2))
    else:
        print(json.dumps(content, indent=2))
