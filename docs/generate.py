"""Writes docs/reference.md from the enumerations and commands that the program really has.

Usage: python docs/generate.py [--check]
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import typer.main

from drivers.errors import Fault
from farm.cli.main import app
from farm.errors import EXIT_CODES, ErrorCode, ExitCode
from farm.model import Bed, FilamentState, HoldCode, JobState, Link, PrintState
from farm.tracking.faults import OwnFault
from slicing.errors import Rule

PAGE = Path(__file__).with_name("reference.md")
ENUMERATIONS: tuple[tuple[str, type[Enum]], ...] = (
    ("States of a job", JobState),
    ("States of a print", PrintState),
    ("Bed", Bed),
    ("Filament", FilamentState),
    ("Link to a printer", Link),
    ("Why a plate or a job waits (`hold.code`)", HoldCode),
    ("Faults of a print", Fault),
    ("Faults of a print that the farm itself tells", OwnFault),
    ("Rules that a slice must keep", Rule),
)


def commands() -> Iterator[tuple[str, Any]]:
    """Every command of `farm`, by name."""
    group: Any = typer.main.get_command(app)
    yield from group.commands.items()


def table(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    lines = [list(headings)]
    lines.append(["---"] * len(lines[0]))
    lines += [[cell.replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def page() -> str:
    """The whole page."""
    parts = [
        "# Reference\n\nMade by `python docs/generate.py` from the program itself; `make check` compares."
    ]
    parts.append("## Commands")
    for name, command in commands():
        options = [
            (" ".join(f"`{word}`" for word in param.opts), getattr(param, "help", None) or "")
            for param in command.params
            if not getattr(param, "hidden", False)
        ]
        parts.append(f"### farm {name}\n{command.help}\n\n{table(('option', 'meaning'), options)}")
    parts.append("## Exit codes")
    parts.append(
        table(
            ("code", "name", "errors that end with it"),
            (
                (
                    str(int(code)),
                    code.name.lower(),
                    ", ".join(f"`{error}`" for error in ErrorCode if EXIT_CODES[error] is code) or "-",
                )
                for code in ExitCode
            ),
        )
    )
    for title, kind in ENUMERATIONS:
        parts.append(f"## {title}\n" + ", ".join(f"`{member.value}`" for member in kind))
    return "\n\n".join(parts) + "\n"


def main() -> int:
    """Write the page, or with --check say whether it is what it should be."""
    text = page()
    if "--check" not in sys.argv:
        PAGE.write_text(text)
        return 0
    if PAGE.read_text() == text:
        return 0
    print(f"{PAGE} is not up to date: run `python docs/generate.py`", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
