"""`farm pause` and `farm resume`: prints that wait for a person."""

from __future__ import annotations

from typing import Annotated

import typer

from farm.cli import completion
from farm.cli.client.daemon_client import Client
from farm.cli.commands.operate import place_of
from farm.cli.options import placed
from farm.paths import Places

Targets = Annotated[
    list[str], typer.Argument(help="Printers, jobs (3) or parts (3/p01).", autocompletion=completion.targets)
]

Again = Annotated[
    list[str] | None,
    typer.Argument(help="Printers, jobs or parts; none after an outage.", autocompletion=completion.targets),
]


@placed
def pause(places: Places, targets: Targets) -> None:
    """Let prints wait: filament parked, head aside, nozzle off, bed warm; at most two hours.

    A part that waits for a printer, and what waits of a job, is kept from every printer.
    """
    client = Client(places.socket)
    for target in targets:
        place = place_of(target)
        printer = client.tell(f"{place}/pause")
        what = "pausing, and nothing more of it starts" if target.isdigit() else "pausing"
        if "/parts/" in place:
            what = f"pausing on {printer}" if printer else "goes to no printer"
        print(f"{_named(target)}: {what}; `farm resume {target}` lets it go on")


@placed
def resume(places: Places, targets: Again = None) -> None:
    """Let paused prints go on (the nozzle is heated first); without a name, the farm after an outage."""
    client = Client(places.socket)
    if not targets:
        lost = client.tell("/outage/confirm")
        print(f"the farm goes on; {lost} were lost: `farm cleared PRINTER` for each, once looked at")
    for target in targets or ():
        client.tell(f"{place_of(target)}/resume")
        print(f"{_named(target)}: goes on")
    for item in client.status().todo:
        if item.code == "hours":  # it goes on, but not to its end
            print(item.text)


def _named(target: str) -> str:
    return f"job {target}" if target.isdigit() else target
