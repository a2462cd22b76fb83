"""Generator of the man pages of all commands, and of their completion for bash, zsh and fish.

Usage: python deploy/debian/command_files.py SHARE VERSION     SHARE: the folder that becomes /usr/share
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from typer._completion_shared import get_completion_script

from farm.cli.command_group import load_commands
from farm.cli.main import app
from farm.errors import ExitCode

COMPLETIONS = {
    "bash": "bash-completion/completions/farm",
    "zsh": "zsh/vendor-completions/_farm",
    "fish": "fish/vendor_completions.d/farm.fish",
}
FILES = (
    ("/etc/farm/fleet.yaml", "The fleet; in the current folder or in ~/.config/farm for a farm of your own."),
    ("/run/farm/farm.sock", "Socket of the daemon that all members of the group farm share."),
    ("/var/lib/farm", "Jobs, files and backups."),
)


def escape(text: str) -> str:
    """Escape text for roff: backslashes, hyphens, and dots and quotes at the beginning of a line."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"(?m)^([.'])", r"\\&\1", text)


def write_header(name: str, summary: str, version: str) -> Iterator[str]:
    """Yield the title and the section NAME of a man page."""
    yield f'.TH "{escape(name.upper())}" 1 "" "farm {escape(version)}" "User commands"'
    yield f".SH NAME\n{escape(name)} \\- {escape(summary)}"


def write_entries(title: str, entries: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield a section with a list of terms and their meanings; nothing if there are none."""
    lines = [f".TP\n.B {escape(term)}\n{escape(meaning or '(no description)')}" for term, meaning in entries]
    if lines:
        yield f".SH {title}"
        yield from lines


def summarise(text: str) -> str:
    """Return the first sentence of a help text, for the section NAME."""
    return " ".join(text.split("\n\n")[0].split()).rstrip(".")


def format_page(name: str, command: Any, version: str) -> str:
    """Format the man page of a command.

    Parameters
    ----------
    name
        The command's name on the command line.
    command
        The loaded command.
    version
        Version of farm.

    Returns
    -------
    str
        The page as roff text.
    """
    visible_params = [param for param in command.params if not getattr(param, "hidden", False)]
    options = [param for param in visible_params if param.param_type_name != "argument"]
    arguments = [
        (param.metavar or param.name or "").upper() for param in visible_params if param not in options
    ]
    lines = [*write_header(f"farm-{name}", summarise(command.help), version)]
    usage = "".join(["\n.RI [ options ]", *(f"\n.I {escape(word)}" for word in arguments)])
    lines.append(f".SH SYNOPSIS\n.B farm {escape(name)}{usage}")
    paragraphs = (" ".join(text.split()) for text in command.help.split("\n\n"))
    lines.append(".SH DESCRIPTION\n" + "\n.PP\n".join(escape(text) for text in paragraphs))
    argument_params = [param for param in visible_params if param not in options]
    described_arguments = [
        (word, param.help)
        for word, param in zip(arguments, argument_params, strict=True)
        if getattr(param, "help", "")
    ]
    lines += write_entries("ARGUMENTS", described_arguments)
    lines += write_entries(
        "OPTIONS", ((", ".join([*one.opts, *one.secondary_opts]), one.help) for one in options)
    )
    lines.append(".SH SEE ALSO\n.BR farm (1)")
    return "\n".join(lines) + "\n"


def format_main_page(commands: dict[str, Any], version: str) -> str:
    """Format the man page of farm: its commands, exit codes and files."""
    lines = [*write_header("farm", "one fast printer out of a fleet of Ultimaker 2+ printers", version)]
    lines.append(".SH SYNOPSIS\n.B farm\n.I command\n.RI [ options ]")
    lines.append(
        ".SH DESCRIPTION\nCuts large models into parts for the free printers, slices them, and prints "
        "them over USB.\nEach command has its own page, like\n.BR farm\\-submit (1)."
    )
    lines += write_entries("COMMANDS", ((name, summarise(one.help)) for name, one in commands.items()))
    codes = ((str(int(code)), code.name.lower().replace("_", " ")) for code in ExitCode)
    lines += write_entries("EXIT STATUS", codes)
    lines += write_entries("FILES", FILES)
    lines.append(".SH SEE ALSO\n" + ",\n".join(f".BR farm\\-{escape(name)} (1)" for name in sorted(commands)))
    return "\n".join(lines) + "\n"


def write_files(share: Path, version: str) -> None:
    """Write all man pages and completion scripts below a folder."""
    commands = load_commands(app)
    pages = {"farm": format_main_page(commands, version)}
    pages |= {f"farm-{name}": format_page(name, one, version) for name, one in commands.items()}
    (share / "man" / "man1").mkdir(parents=True, exist_ok=True)
    for name, text in pages.items():
        (share / "man" / "man1" / f"{name}.1").write_text(text, encoding="utf-8")
    for shell, place in COMPLETIONS.items():
        (share / place).parent.mkdir(parents=True, exist_ok=True)
        script = get_completion_script(prog_name="farm", complete_var="_FARM_COMPLETE", shell=shell)
        (share / place).write_text(script + "\n", encoding="utf-8")


if __name__ == "__main__":
    write_files(Path(sys.argv[1]), sys.argv[2])
