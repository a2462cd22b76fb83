"""Draw the output of a command on a terminal as an SVG picture.

Usage: python docs/terminal_picture.py OUT.svg [--columns 100] -- COMMAND...
"""

from __future__ import annotations

import argparse
import io
import os
import pty
import sys
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import DIMMED_MONOKAI
from rich.text import Text

FORMAT = """<svg class="rich-terminal" viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font-family: ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace;
  font-size: {char_height}px; line-height: {line_height}px; }}
{styles}
</style>
<defs><clipPath id="{unique_id}-clip-terminal">
<rect x="0" y="0" width="{terminal_width}" height="{terminal_height}" /></clipPath>{lines}</defs>
<rect fill="#1f1f1f" width="{width}" height="{height}" rx="8"/>
<g transform="translate(9, 9)" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}<g class="{unique_id}-matrix">
{matrix}
</g></g></svg>
"""
"""Frame of the picture; rich's own frame loads its font from another host."""


def run_on_terminal(command: list[str], columns: int) -> str:
    """Run a command on a pseudo-terminal, and return its output with its colours."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ |= {"COLUMNS": str(columns), "LINES": "60", "TERM": "xterm-256color"}
        os.execvp(command[0], command)
    output = io.BytesIO()
    while True:
        try:
            piece = os.read(terminal, 4096)
        except OSError:  # on Linux, the other end is closed
            break
        if not piece:
            break
        output.write(piece)
    os.waitpid(pid, 0)
    return output.getvalue().decode(errors="replace").replace("\r\n", "\n")


def draw_output(title: str, output: str, columns: int) -> str:
    """Draw a command and its output as SVG."""
    console = Console(record=True, width=columns, file=io.StringIO(), force_terminal=True)
    console.print(Text(f"$ {title}", style="bold"))
    console.print(Text.from_ansi(output.rstrip()), no_wrap=True, crop=True)
    return console.export_svg(title="", theme=DIMMED_MONOKAI, code_format=FORMAT, unique_id="terminal")


def main() -> int:
    """Run the command and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--columns", type=int, default=100)
    parser.add_argument("--shown", help="the command to show, if it differs from the one that is run")
    parser.add_argument("command", nargs="+")
    arguments = parser.parse_args()
    output = run_on_terminal(arguments.command, arguments.columns)
    title = arguments.shown or " ".join(arguments.command)
    arguments.out.write_text(draw_output(title, output, arguments.columns), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
