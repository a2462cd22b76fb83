"""`farm pause` and `farm resume`: prints that wait for a person."""

from __future__ import annotations

from typing import Annotated

import typer

from farm.cli.client import Client
from farm.cli.operate import FleetFile, Socket, State, me, place_of
from farm.paths import find_places

Targets = Annotated[list[str], typer.Argument(help="Printers, jobs (3) or parts (3/p01).")]

Again = Annotated[list[str] | None, typer.Argument(help="Printers, jobs or parts; none after an outage.")]


def pause(targets: Targets, state: State = None, socket: Socket = None, fleet: FleetFile = None) -> None:
    """Let prints wait: filament parked, head aside, nozzle off, bed warm; at most two hours."""
    client = Client(find_places(state, socket, fleet).socket)
    for target in targets:
        client.tell(f"{place_of(target)}/pause")
        more = ", and nothing more of it starts" if target.isdigit() else ""
        print(f"{_named(target)}: pausing{more}; `farm resume {target}` lets it go on")


def resume(
    targets: Again = None, state: State = None, socket: Socket = None, fleet: FleetFile = None
) -> None:
    """Let paused prints go on (the nozzle is heated first); without a name, the farm after an outage."""
    client = Client(find_places(state, socket, fleet).socket)
    if not targets:
        lost = client.tell("/outage/confirm", by=me())
        print(f"the farm goes on; {lost} were lost: `farm cleared PRINTER` for each, once looked at")
    for target in targets or ():
        client.tell(f"{place_of(target)}/resume")
        print(f"{_named(target)}: goes on")


def _named(target: str) -> str:
    return f"job {target}" if target.isdigit() else target
