"""`farm pause` and `farm resume`: prints, jobs and parts that wait for a person."""

from __future__ import annotations

from typing import Annotated

import typer

from farm.cli import completion
from farm.cli.client.daemon_client import Client
from farm.cli.commands.operate import target_path
from farm.cli.options import placed
from farm.paths import Places

Targets = Annotated[
    list[str], typer.Argument(help="Printers, jobs (3) or parts (3/p01).", autocompletion=completion.targets)
]

Again = Annotated[
    list[str] | None,
    typer.Argument(
        help="Printers, jobs or parts; none: the whole farm after an outage.",
        autocompletion=completion.targets,
    ),
]


@placed
def pause(places: Places, targets: Targets) -> None:
    """Pause prints: filament retracted, head aside, nozzle off, bed warm; at most two hours.

    Paused parts that wait for a printer, and the waiting parts of a paused job, do not start.
    """
    client = Client(places.socket)
    for target in targets:
        place = target_path(target)
        printer = client.tell(f"{place}/pause")
        what = "pausing; none of its waiting parts starts" if target.isdigit() else "pausing"
        if "/parts/" in place:
            what = f"pausing on {printer}" if printer else "will not start"
        print(f"{_named(target)}: {what}; continue with `farm resume {target}`")


@placed
def resume(places: Places, targets: Again = None) -> None:
    """Resume paused prints (the nozzle heats up first), or without a name the farm after an outage."""
    client = Client(places.socket)
    if not targets:
        lost = client.tell("/outage/confirm")
        print(f"the farm goes on; inspect the lost printers ({lost}), then `farm cleared PRINTER` for each")
    for target in targets or ():
        client.tell(f"{target_path(target)}/resume")
        print(f"{_named(target)}: resumed")
    for item in client.status().todo:
        if item.code == "hours":  # resumed, but it will not reach its end
            print(item.text)


def _named(target: str) -> str:
    return f"job {target}" if target.isdigit() else target
