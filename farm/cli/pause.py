"""`farm pause` and `farm resume`: a print that waits for a person."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from farm.cli.client import Client
from farm.paths import find_places

Printers = Annotated[list[str], typer.Argument(help="The printers.")]
State = Annotated[Path | None, typer.Option("--state", help="The state folder (FARM_STATE).")]
Socket = Annotated[Path | None, typer.Option("--socket", help="The daemon's socket (FARM_SOCKET).")]
FleetFile = Annotated[Path | None, typer.Option("--fleet", help="The fleet file (FARM_FLEET).")]


def pause(printers: Printers, state: State = None, socket: Socket = None, fleet: FleetFile = None) -> None:
    """Let prints wait: filament parked, head aside, nozzle off, bed warm; at most two hours."""
    client = Client(find_places(state, socket, fleet).socket)
    for printer in printers:
        client.pause(printer)
        print(f"{printer}: pausing; `farm resume {printer}` lets it go on")


def resume(printers: Printers, state: State = None, socket: Socket = None, fleet: FleetFile = None) -> None:
    """Let paused prints go on: the nozzle is heated first."""
    client = Client(find_places(state, socket, fleet).socket)
    for printer in printers:
        client.resume(printer)
        print(f"{printer}: goes on")
