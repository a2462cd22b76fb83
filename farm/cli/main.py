"""The `farm` command: parse, call the daemon, render."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

import farm
from drivers.printers.profiles import PROFILES
from farm.cli import completion
from farm.cli.client.daemon_client import Client
from farm.cli.commands import discover, estop, history, local, operate, pause, prepare, submit
from farm.cli.display import tables
from farm.cli.display.format import say
from farm.cli.options import Json, placed
from farm.config import Fleet, load_fleet
from farm.errors import DaemonUnreachable, ExitCode, FarmError
from farm.paths import Places
from farm.text import count

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


_START_PATIENCE_S = 60.0
_END_PATIENCE_S = 180.0


def _fleet(places: Places) -> Fleet:
    from farm.planning.fleet_check import mistake_in

    return load_fleet(places.fleet, frozenset(PROFILES), mistake_in)


@app.command()
@placed
def up(
    places: Places,
    replace: Annotated[
        list[str] | None,
        typer.Option(help="Replace the agent of this idle printer.", autocompletion=completion.printers),
    ] = None,
) -> None:
    """Start the daemon, which starts an agent for each printer, or adopts those that are alive."""
    checked = _fleet(places)
    for printer in checked.printers:
        here = printer.enabled and printer.host is None and printer.port.startswith("/")
        if here and not Path(printer.port).exists():
            say(f"{printer.name}: port {printer.port} is not there; is it plugged in? The others go on")
    if checked.fleet.notify and places.fleet.stat().st_mode & 0o004:
        say(f"{places.fleet} may hold passwords under `notify`, and everybody may read it: `chmod o-r` it")
    client = Client(places.socket)
    try:
        running = client.status()
    except DaemonUnreachable:
        _start_daemon(places, client)
        running = client.status()
        printers = count(len(running.printers), "printer")
        print(f"farm {running.daemon.version} is up: {printers}, pid {running.daemon.pid}")
    else:
        print(f"farm {running.daemon.version} is up already: pid {running.daemon.pid}")
    for name in replace or ():
        client.tell(f"/printers/{name}/replace")
        print(f"{name}: its agent ends, and a new one starts")


def _start_daemon(places: Places, client: Client) -> None:
    places.state.make()
    command = [sys.executable, "-P", "-m", "farm.cli.main", "daemon"]
    command += [
        "--state",
        str(places.state.root),
        "--socket",
        str(places.socket),
        "--fleet",
        str(places.fleet),
    ]
    with places.state.log.open("ab") as log:
        start = log.tell()
        child = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True, cwd="/"
        )
    give_up = time.monotonic() + _START_PATIENCE_S
    while time.monotonic() < give_up:
        try:
            client.status()
            return
        except DaemonUnreachable:
            if child.poll() is not None:
                break
            time.sleep(0.1)
    with places.state.log.open("rb") as log:
        log.seek(start)
        lines = log.read().decode(errors="replace").strip().splitlines()
    last = lines[-1].removeprefix("farm: ") if lines else "it said nothing"
    raise FarmError(f"the daemon did not start: {last}; its log is {places.state.log}")


@app.command()
@placed
def daemon(places: Places) -> None:
    """Run the daemon in the foreground (`farm up` does it in the background)."""
    from farm.daemon import run

    run(_fleet(places), places)


@app.command()
@placed
def down(
    places: Places,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until nothing prints any more.")] = False,
    now: Annotated[bool, typer.Option("--now", help="End everything safely, now.")] = False,
) -> None:
    """Stop the farm: agents, then the daemon. Refused while something prints."""
    if wait and now:
        raise typer.BadParameter("--wait and --now exclude each other", param_hint="--now")
    client = Client(places.socket)
    pid = client.status().daemon.pid
    client.down(now, wait)
    give_up = time.monotonic() + _END_PATIENCE_S
    while wait or time.monotonic() < give_up:
        if not _exists(pid):
            print("farm is down")
            return
        time.sleep(0.1)
    raise FarmError(
        f"the daemon (pid {pid}) is still there; `farm status`, and its log {places.state.log}, say why"
    )


def _exists(pid: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@app.command()
@placed
def status(
    places: Places,
    job: Annotated[int | None, typer.Argument(help="Only this job.", autocompletion=completion.jobs)] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Show it anew until Ctrl-C.")] = False,
    json: Json = False,
) -> None:
    """What a person has to do now, the printers, the jobs, and why each waiting plate waits."""
    client = Client(places.socket)
    if watch and not json:
        tables.watch(client, job)
    elif job is not None:
        answer = client.job(job)
        print(answer.model_dump_json(by_alias=True, indent=2)) if json else tables.job(answer.job)
    else:
        whole = client.status()
        print(whole.model_dump_json(by_alias=True, indent=2)) if json else tables.status(whole)


app.command()(submit.submit)
app.command()(prepare.load)
app.command()(prepare.approve)
app.command()(history.history)
app.command()(history.report)
app.command()(operate.cleared)
app.command()(operate.fail)
app.command()(operate.reprint)
app.command()(operate.cancel)
app.command()(operate.maintenance)
app.command()(local.decompose)
app.command("slice")(local.slice_model)
app.command()(pause.pause)
app.command()(pause.resume)
app.command()(discover.discover)
app.command()(estop.estop)


def main() -> None:
    """The entry point: a person's mistake gets one line, never a traceback."""
    try:
        code = app(prog_name="farm", standalone_mode=False)
        if code == ExitCode.INTERRUPTED:
            say("interrupted")
        sys.exit(code or 0)
    except FarmError as error:
        say(" ".join(str(error).split()))
        sys.exit(int(error.exit_code))
    except typer.TyperException as error:
        message = " ".join(error.format_message().replace("Value error, ", "").split()).rstrip(".")
        if message:  # help, where nothing was asked, is shown by now
            command = context.command_path if (context := getattr(error, "ctx", None)) else "farm"
            say(f"{message}; `{command} --help` shows how it is written")
        sys.exit(int(ExitCode.USAGE))
    except typer.Abort:
        say("given up")
        sys.exit(int(ExitCode.FAILED))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(int(ExitCode.FAILED))


if __name__ == "__main__":
    main()
