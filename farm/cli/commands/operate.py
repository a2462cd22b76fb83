"""What an operator says: this is clear, this is good or bad, this goes wrong, print it again, leave it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated

import typer

from farm.api import Cleared, ClearedRequest, PrinterView
from farm.cli import completion
from farm.cli.client.daemon_client import Client
from farm.cli.options import Job, Printer, Why, placed
from farm.errors import NoSuchThing
from farm.model import FilamentState, HoldCode, Link
from farm.paths import Places

Target = Annotated[
    str,
    typer.Argument(
        help="A job (3), a part (3/p01), or a printer: what it prints.", autocompletion=completion.targets
    ),
]


def place_of(target: str) -> str:
    """Where the daemon has what a person names: a job (3), a part (3/p01 or 3/01) or a printer."""
    if target.isdigit():
        return f"/jobs/{target}"
    if re.fullmatch(r"\d+/p?\d+[a-z]*", target):
        job, _, part = target.partition("/")
        return f"/jobs/{job}/parts/{part}"
    return f"/printers/{target}"


def waiting_for_it(printers: Iterable[PrinterView]) -> list[str]:
    """The printers that `all` means: none that somebody has in hand or that is away; a part may lie there."""
    others = (HoldCode.MAINTENANCE, Link.ABSENT)
    return [p.name for p in printers if p.print is None and p.hold is not None and p.state not in others]


@placed
def cleared(
    places: Places,
    printers: Annotated[
        list[str],
        typer.Argument(help="The printers whose beds are clear, or all.", autocompletion=completion.beds),
    ],
    bad: Annotated[bool, typer.Option("--bad", help="What was printed is bad: print it again.")] = False,
    why: Annotated[str | None, typer.Option(help="What is wrong with it; says --bad too.")] = None,
    good: Annotated[
        str | None,
        typer.Option(
            metavar="PART", help="This part is whole, though its print failed: do not print it again."
        ),
    ] = None,
    filament: Annotated[FilamentState | None, typer.Option(help="Where the filament is, if known.")] = None,
) -> None:
    """Say that a bed is clear, what was printed there good (or --bad), and the printer looked at."""
    if good is not None and (bad or why is not None):
        raise typer.BadParameter("a part is good or bad: leave one out", param_hint="--good")
    if good is not None and (len(printers) != 1 or printers == ["all"]):
        raise typer.BadParameter("name the one printer that the part lies on", param_hint="--good")
    client = Client(places.socket)
    fleet_now = {p.name: p for p in client.status().printers}
    if printers == ["all"]:
        if bad:
            raise typer.BadParameter("name the printers whose parts are bad", param_hint="--bad")
        printers = waiting_for_it(fleet_now.values())
        if not printers:
            print("there is nothing to clear")
    unknown = [name for name in printers if name not in fleet_now]
    if unknown:
        raise NoSuchThing(f"there is no printer {' '.join(unknown)}; the fleet has {' '.join(fleet_now)}")
    request = ClearedRequest(filament=filament, bad=bad or why is not None, why=why, good=good)
    for printer in printers:
        answer = client.cleared(printer, request)
        print("; ".join((f"{printer}: bed clear", *_became(request, answer))))


def _became(request: ClearedRequest, answer: Cleared) -> list[str]:
    """What becomes of the part that lay on a bed."""
    if request.bad and answer.again is None:
        return ["its part is not printed again: it was cancelled"]
    if request.bad:
        return [f"part {answer.again} is printed again"]
    if answer.good is None:
        return []
    again = [f"{name} prints it again already: `farm cancel {name}` ends that" for name in answer.printed_on]
    return [f"part {answer.good} is good" + ("" if again else ", and not printed again"), *again]


@placed
def fail(places: Places, printer: Printer, why: Why = "") -> None:
    """End a print that goes wrong, safely, and print its part again."""
    Client(places.socket).tell(f"/printers/{printer}/fail", why)
    print(f"{printer}: its print ends, its part is printed again; take it off, then `farm cleared {printer}`")


@placed
def reprint(
    places: Places,
    job: Job,
    part: Annotated[
        str, typer.Argument(help="The part, as `farm status JOB` names it.", autocompletion=completion.parts)
    ],
    why: Why = "",
) -> None:
    """Print a part again, whatever became of it, at any later time."""
    path = f"/jobs/{job}/parts/{part.rpartition('/')[2]}/reprint"
    name = Client(places.socket).tell(path, why)
    print(f"part {name} is printed again")


@placed
def cancel(
    places: Places,
    target: Target,
) -> None:
    """End what prints safely, and never try it again; what waits is not printed."""
    client = Client(places.socket)
    if not target.isdigit():
        name = client.tell(f"{place_of(target)}/cancel")
        print(f"part {name} is cancelled; where it was being printed, the bed has to be cleared")
        return
    answer = client.cancel(int(target))
    printing = sorted({plate.printer for plate in answer.job.plates if plate.printing})
    print(f"job {target} is cancelled{_ending(printing)}")


def _ending(printing: list[str]) -> str:
    if not printing:
        return ""
    ends = "end safely, their beds have" if len(printing) > 1 else "ends safely, its bed has"
    return f"; {' '.join(printing)} {ends} to be cleared"


@placed
def maintenance(
    places: Places,
    printer: Printer,
    why: Why = "",
    done: Annotated[bool, typer.Option("--done", help="It can be used again.")] = False,
) -> None:
    """Take a printer out of use (what it prints goes on to its end), or put it back (--done)."""
    client = Client(places.socket)
    if done:
        client.tell(f"/printers/{printer}/maintained")
        print(f"{printer}: in use again")
    elif not why:
        raise typer.BadParameter("say why, for those who come after you", param_hint="--why")
    else:
        client.tell(f"/printers/{printer}/maintenance", why)
        print(f"{printer}: in maintenance; `farm maintenance {printer} --done` puts it back")
