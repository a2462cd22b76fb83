"""The `farm` command: the table of its commands, and its exit codes."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Annotated

import typer

import farm
from farm.cli.commands import daemon, estop, installation, local, operate, status, submit
from farm.cli.display import print_notice
from farm.errors import ExitCode, FarmError

app = typer.Typer(
    help="Turns a fleet of Ultimaker 2+ printers into one fast printer for large models.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"farm {farm.__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Turns a fleet of Ultimaker 2+ printers into one fast printer for large models."""


_COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    "The farm": (daemon.up, daemon.down, status.status, installation.doctor, daemon.daemon),
    "Jobs": (
        submit.submit,
        submit.approve,
        operate.pause,
        operate.resume,
        operate.cancel,
        operate.reprint,
        status.history,
        status.report,
    ),
    "Printers": (
        operate.cleared,
        operate.fail,
        operate.load,
        operate.maintenance,
        installation.discover,
        estop.estop,
    ),
    "Without the daemon": (local.decompose, local.slice_model),
}
"""Groups in the order in which `farm --help` lists them."""
for _group, _commands in _COMMANDS.items():
    for _command in _commands:
        app.command("slice" if _command is local.slice_model else None, rich_help_panel=_group)(_command)


def main() -> None:
    """Run a command. An error is one line on stderr and an exit code, never a traceback."""
    try:
        code = app(prog_name="farm", standalone_mode=False)
        if code == ExitCode.INTERRUPTED:
            print_notice("interrupted")
        sys.exit(code or 0)
    except FarmError as error:
        print_notice(" ".join(str(error).split()))
        sys.exit(int(error.exit_code))
    except typer.TyperException as error:
        message = " ".join(error.format_message().replace("Value error, ", "").split()).rstrip(".")
        if message:  # empty if the help was shown
            path = context.command_path if (context := getattr(error, "ctx", None)) else "farm"
            print_notice(f"{message}; see `{path} --help`")
        sys.exit(int(ExitCode.USAGE))
    except typer.Abort:
        print_notice("aborted")
        sys.exit(int(ExitCode.FAILED))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(int(ExitCode.FAILED))


if __name__ == "__main__":
    main()
