"""`farm up`, `farm down` and `farm daemon`: start and stop the daemon; `farm host`: run agents for it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from drivers.printers import PROFILES
from farm.cli import completion
from farm.cli.client import Client
from farm.cli.notices import print_notice
from farm.cli.options import with_paths
from farm.config import Fleet
from farm.errors import DaemonUnreachable, FarmError
from farm.fleet_file import load_fleet
from farm.paths import FarmPaths
from farm.text import format_count

_START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 180.0
_WORLD_READABLE_BIT = 0o004


@with_paths
def up(
    paths: FarmPaths,
    replace: Annotated[
        list[str] | None,
        typer.Option(help="Replace the agent of this idle printer.", autocompletion=completion.printers),
    ] = None,
) -> None:
    """Start the daemon, and an agent for each printer that has none."""
    fleet = _load_fleet(paths)
    _print_warnings(fleet, paths)
    client = Client(paths.socket)
    try:
        status = client.fetch_status()
    except DaemonUnreachable:
        _start_daemon(paths, client)
        status = client.fetch_status()
        printers = format_count(len(status.printers), "printer")
        print(f"farm {status.daemon.version} is up: {printers}, pid {status.daemon.pid}")
    else:
        print(f"farm {status.daemon.version} is already up: pid {status.daemon.pid}")
    for name in replace or ():
        client.send_command(f"/printers/{name}/replace")
        print(f"{name}: its agent was replaced")


def _load_fleet(paths: FarmPaths) -> Fleet:
    from farm.planning.inspection import complete_section

    return load_fleet(paths.fleet, frozenset(PROFILES), complete_section)


def _print_warnings(fleet: Fleet, paths: FarmPaths) -> None:
    """Warn about missing ports, and about a fleet file with passwords that all users can read."""
    for printer in fleet.printers:
        is_local = printer.enabled and printer.host is None and printer.port.startswith("/")
        if is_local and not Path(printer.port).exists():
            print_notice(
                f"{printer.name}: there is no port {printer.port}; check its USB cable and power; the other "
                "printers start without it"
            )
    if fleet.fleet.notify and paths.fleet.stat().st_mode & _WORLD_READABLE_BIT:
        print_notice(
            f"{paths.fleet} may contain passwords under `notify`, and every user can read it: "
            f"`chmod o-r {paths.fleet}`"
        )


def _start_daemon(paths: FarmPaths, client: Client) -> None:
    """Start the daemon in the background, and wait until it answers.

    Raises
    ------
    FarmError
        If the daemon ended or does not answer; the message contains the last line of its log.
    """
    paths.state.make()
    command = [sys.executable, "-P", "-m", "farm.cli.main", "daemon"]
    command += ["--state", str(paths.state.root)]
    command += ["--socket", str(paths.socket)]
    command += ["--fleet", str(paths.fleet)]
    paths.state.log.touch(mode=0o600)
    with paths.state.log.open("ab") as log:
        start = log.tell()
        child = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True, cwd="/"
        )
    deadline_s = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline_s:
        try:
            client.fetch_status()
            return
        except DaemonUnreachable:
            if child.poll() is not None:
                break
            time.sleep(0.1)
    with paths.state.log.open("rb") as log:
        log.seek(start)
        lines = log.read().decode(errors="replace").strip().splitlines()
    last_line = lines[-1].removeprefix("farm: ") if lines else "it wrote no log"
    raise FarmError(f"the daemon did not start: {last_line}; its log is {paths.state.log}")


@with_paths
def daemon(paths: FarmPaths) -> None:
    """Run the daemon in the foreground; `farm up` runs it in the background."""
    from farm.daemon import run

    os.umask(0o077)  # new files are private, even if the state folder is readable by all
    run(_load_fleet(paths), paths)


@with_paths
def down(
    paths: FarmPaths,
    wait: Annotated[
        bool, typer.Option("--wait", help="Let prints in progress end first, and start no new ones.")
    ] = False,
    now: Annotated[bool, typer.Option("--now", help="Stop prints in progress safely first.")] = False,
) -> None:
    """Stop the daemon and the agents. While the farm is printing or planning, --wait or --now is needed."""
    if wait and now:
        raise typer.BadParameter("--wait and --now exclude each other", param_hint="--now")
    client = Client(paths.socket)
    pid = client.fetch_status().daemon.pid
    client.shut_down(now, wait)
    deadline_s = time.monotonic() + _STOP_TIMEOUT_S
    while wait or time.monotonic() < deadline_s:
        if not _is_running(pid):
            print("farm is down")
            return
        time.sleep(0.1)
    raise FarmError(
        f"the daemon (pid {pid}) has not ended within {_STOP_TIMEOUT_S:.0f} s; look at `farm status` and "
        f"at its log {paths.state.log}"
    )


def host(
    farm: Annotated[
        str | None,
        typer.Option(help="Run the service of this farm in the foreground, as a systemd unit does."),
    ] = None,
) -> None:
    """Run the agents of a farm's printers on this host; the daemon starts this command over ssh.

    Its stdin and stdout are the connection to the daemon. If the connection ends, the agents keep running.
    """
    if farm is not None:
        from drivers.host.service import run_service

        raise typer.Exit(run_service(farm))
    if sys.stdin.isatty():
        raise typer.BadParameter(
            "the daemon runs this command over ssh: write it as `host_command` in fleet.yaml, or give --farm",
            param_hint="stdin",
        )
    from drivers.host.program import serve_stdio

    raise typer.Exit(serve_stdio())


def _is_running(pid: int) -> bool:
    """Return whether a process exists and is not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
