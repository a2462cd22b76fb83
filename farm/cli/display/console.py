"""Consoles and tables for people: what they, and printers, have written is text there and never markup."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table


def console(stderr: bool = False) -> Console:
    """As wide as the terminal; into a file or a pipe as wide as it takes."""
    wide = None if (sys.stderr if stderr else sys.stdout).isatty() else 200
    return Console(stderr=stderr, highlight=False, markup=False, soft_wrap=True, width=wide)


def table(*headings: str) -> Table:
    """Columns without lines between them."""
    columns = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in headings:
        columns.add_column(heading, no_wrap=True)
    return columns
