"""Entry point of `farm`: the table of its commands, and its exit codes."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

import farm
from farm.cli.command_group import CommandEntry, make_group
from farm.cli.notices import print_notice
from farm.errors import ExitCode, FarmError

COMMANDS = {
    "The farm": (
        CommandEntry("up", "daemon.up", "Start the daemon, and an agent for each printer that has none."),
        CommandEntry(
            "down",
            "daemon.down",
            "Stop the daemon and the agents. While the farm is printing or planning, --wait or --now is "
            "needed.",
        ),
        CommandEntry(
            "setup",
            "installation.setup",
            "Install CuraEngine and its settings, and compile the planning code; run it after each update.",
        ),
        CommandEntry(
            "status",
            "status.status",
            "Show what you have to do now, the printers, the jobs, and why each waiting plate waits.",
        ),
        CommandEntry(
            "doctor",
            "installation.doctor",
            "Check database, files, agents, ports, CuraEngine, clock and disks, and say what to do.",
        ),
        CommandEntry(
            "prune",
            "prune.prune",
            "Delete the files of old jobs now instead of at night (see `fleet.keep`); figures and pictures "
            "stay.",
        ),
        CommandEntry(
            "key",
            "keys.key",
            "Add, list and revoke the keys with which programs and people on other computers use the farm; "
            "grant or deny a program's request for a key (see `web` in fleet.yaml).",
        ),
        CommandEntry(
            "web",
            "web.web",
            "Print a link that logs a browser in to the farm's pages; it works once, within five minutes.",
        ),
        CommandEntry(
            "daemon",
            "daemon.daemon",
            "Run the daemon in the foreground; `farm up` runs it in the background.",
        ),
    ),
    "Jobs": (
        CommandEntry(
            "submit",
            "submit.submit",
            "Decompose a model for the free printers, slice the parts and print them.",
        ),
        CommandEntry(
            "approve", "submit.approve", "Release a held job, which is then printed exactly as planned."
        ),
        CommandEntry(
            "queue",
            "queue.queue",
            "Show the jobs in the order in which they get printers; move one, or change its start time.",
        ),
        CommandEntry(
            "pause",
            "operate.pause",
            "Pause prints, or a whole job: the head moves aside, the nozzle cools, and the bed stays warm.",
        ),
        CommandEntry(
            "resume",
            "operate.resume",
            "Resume a paused job, part or printer; without a name, the whole farm after an outage.",
        ),
        CommandEntry(
            "cancel",
            "operate.cancel",
            "Cancel a job or a part: its prints end safely, and it is not printed again.",
        ),
        CommandEntry(
            "reprint",
            "operate.reprint",
            "Print a part again, even if it was printed or cancelled, or failed too often.",
        ),
        CommandEntry(
            "assembled",
            "operate.assembled",
            "Report that the parts of a job are glued, and how long that took.",
        ),
        CommandEntry(
            "history",
            "status.history",
            "List the latest prints: duration, deviation from the plan, filament and outcome.",
        ),
        CommandEntry(
            "report",
            "status.report",
            "Write an HTML page on a job: its figures, a Gantt chart, what failed and why, and its parts.",
        ),
        CommandEntry(
            "fetch",
            "fetch.fetch",
            "Fetch the files of a job: parts, G-code, pictures, stills, and a report.",
        ),
    ),
    "Printers": (
        CommandEntry(
            "cleared",
            "operate.cleared",
            "Confirm that beds are clear, printers inspected, and their printed parts good (or --bad).",
        ),
        CommandEntry("fail", "operate.fail", "End a failing print safely, and print its part again."),
        CommandEntry(
            "load",
            "operate.load",
            "Record a new reel or nozzle. No print starts with too little filament left.",
        ),
        CommandEntry(
            "maintenance",
            "operate.maintenance",
            "Take a printer out of use after its current print, or put it back into use (--done).",
        ),
        CommandEntry(
            "discover",
            "installation.discover",
            "List the plugged-in serial ports and their printers, without opening any of them.",
        ),
        CommandEntry(
            "hosts",
            "status.hosts",
            "Show the other computers that run agents, with the connection of each to the daemon; update "
            "their agents (--update).",
        ),
        CommandEntry(
            "estop",
            "estop.estop",
            "Stop printers at once by resetting their boards, even if the daemon and the agents hang.",
        ),
    ),
    "Without the daemon": (
        CommandEntry(
            "decompose",
            "local.decompose",
            "Cut a model into parts of about equal printing time, and write them to a folder.",
        ),
        CommandEntry(
            "slice",
            "local.slice_model",
            "Slice a model as one plate for printing over USB, with all checks.",
        ),
        CommandEntry(
            "coupon",
            "local.coupon",
            "Write a block with holes and grooves of several widths, to find the fit of pins on a printer.",
        ),
        CommandEntry(
            "host",
            "daemon.host",
            "Run the agents of a farm's printers on this host; the daemon starts this command over ssh.",
        ),
        CommandEntry(
            "worker",
            "local.worker",
            "Run tasks of farms on this computer, as a worker of a Dask cluster.",
        ),
    ),
}
"""Commands by the heading under which `farm --help` lists them, in the order of that list."""
app = typer.Typer(
    cls=make_group(COMMANDS),
    help="Turns a fleet of Ultimaker 2+ printers into one fast printer for large models.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _show_version(show: bool) -> None:
    if show:
        print(f"farm {farm.__version__}")
        raise typer.Exit


@app.callback()
def parse_common_options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Parse the options that stand before the name of a command."""


def main() -> None:
    """Run a command; print an error as one line on stderr, never as a traceback, and set the exit code."""
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
