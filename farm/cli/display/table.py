"""Tables that fit into the width of a terminal: less important columns are shortened or left out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from farm.cli.display.console import HEADING_STYLE

_GAP = 2  # spaces between two columns
_INDENT = 2  # indent of the continuation lines of a row
_COMMAND_PATTERN = re.compile(r"`[^`]*`")
_NON_BREAKING_SPACE = "\ue000"  # replaces a space at which a line must not be wrapped
_CONSOLE = Console(width=80)  # required by `Text.wrap`; nothing is printed on it


@dataclass(frozen=True, slots=True)
class Column:
    """Column of a table.

    Attributes
    ----------
    heading
        Text in the first line of the column.
    rank
        0 for a column that is always shown; other columns may be left out, those of the highest rank first.
    min_width
        Width to which the cells may be shortened; None if they must not be shortened.
    """

    heading: str
    rank: int = 0
    min_width: int | None = None


def lay_out_table(columns: Sequence[Column], rows: Sequence[Sequence[str]], width: int | None) -> list[Text]:
    """Lay out a table on lines of at most `width` terminal columns, the headings first.

    If even the columns of rank 0 are too wide, each row takes several lines.

    Parameters
    ----------
    columns
        The columns, from left to right.
    rows
        The cells of each row, one for each column.
    width
        Width of the terminal; None for no limit.
    """
    full_widths = [
        max(cell_len(text) for text in (column.heading, *(row[i] for row in rows)))
        for i, column in enumerate(columns)
    ]
    empty_flags = [not any(row[i] for row in rows) for i in range(len(columns))]
    widths = full_widths if width is None else _fit_widths(columns, full_widths, empty_flags, width)
    headings = [column.heading for column in columns]
    styles = [HEADING_STYLE, *[""] * len(rows)]
    if widths is None:
        required_columns = [i for i, column in enumerate(columns) if column.rank == 0]
        return [
            line
            for row, style in zip((headings, *rows), styles, strict=True)
            for line in _stack_row([row[i] for i in required_columns], width or 1, style)
        ]
    return [_join_row(row, widths, style) for row, style in zip((headings, *rows), styles, strict=True)]


def wrap_text(text: Text, width: int | None, indent: int) -> list[Text]:
    """Wrap a text at its spaces into lines of at most `width` columns; all but the first are indented.

    A command in backticks stays on one line if it fits.
    """
    if width is None or text.cell_len <= width:
        return [text]
    text = text.copy()
    text.plain = _COMMAND_PATTERN.sub(
        lambda command: command[0].replace(" ", _NON_BREAKING_SPACE), text.plain
    )
    first, *rest = _wrap_lines(text, width)
    lines = [first]
    if rest:
        remainder = text[len(first.plain) :]
        remainder = remainder[len(remainder.plain) - len(remainder.plain.lstrip()) :]
        wrapped_lines = _wrap_lines(remainder, max(1, width - indent))
        lines += [Text.assemble(" " * min(indent, width - 1), line) for line in wrapped_lines]
    for line in lines:
        line.plain = line.plain.replace(_NON_BREAKING_SPACE, " ")
    return lines


def _wrap_lines(text: Text, width: int) -> list[Text]:
    lines = list(text.wrap(_CONSOLE, width, overflow="fold"))
    for line in lines:
        line.rstrip()
    return lines


def _fit_widths(
    columns: Sequence[Column], full_widths: Sequence[int], empty_flags: Sequence[bool], width: int
) -> list[int] | None:
    """Choose the width of each column, 0 to leave it out; return None if columns of rank 0 do not fit."""
    min_widths = [
        full_width if c.min_width is None else min(full_width, c.min_width)
        for c, full_width in zip(columns, full_widths, strict=True)
    ]
    visible_columns = [i for i, _ in enumerate(columns)]
    removal_order = sorted(visible_columns, key=lambda i: (empty_flags[i], columns[i].rank), reverse=True)

    def compute_free_width(widths: Sequence[int]) -> int:
        return width - sum(widths[i] for i in visible_columns) - _GAP * (len(visible_columns) - 1)

    removable = [i for i in removal_order if columns[i].rank > 0]
    while compute_free_width(full_widths if any(empty_flags[i] for i in removable) else min_widths) < 0:
        if not removable:
            return None
        visible_columns.remove(removable.pop(0))
    fitted_widths = [min_widths[i] if i in visible_columns else 0 for i, _ in enumerate(columns)]
    free_width = compute_free_width(fitted_widths)
    for i in sorted(visible_columns, key=lambda i: columns[i].rank):
        extra = min(free_width, full_widths[i] - fitted_widths[i])
        fitted_widths[i] += extra
        free_width -= extra
    return fitted_widths


def _join_row(cells: Sequence[str], widths: Sequence[int], style: str) -> Text:
    """Join the cells of a row, each padded to the width of its column."""
    row = Text(style=style)
    for cell, width in zip(cells, widths, strict=True):
        if width:
            text = Text(cell)
            text.truncate(width, overflow="ellipsis", pad=True)
            row.append_text(text).append(" " * _GAP)
    row.rstrip()
    return row


def _stack_row(cells: Sequence[str], width: int, style: str) -> list[Text]:
    """Join the cells of a row, and wrap the result at the width of the terminal."""
    return wrap_text(Text((" " * _GAP).join(filter(None, cells)), style=style), width, _INDENT)
