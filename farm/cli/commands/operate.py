"""The operator's commands: `farm cleared`, `fail`, `reprint`, `cancel` and `maintenance`."""

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
        help="A job (3), a part (3/p01), or a printer (its print).", autocompletion=completion.targets
    ),
]


def target_path(target: str) -> str:
    """Build the HTTP path of a job (3), a part (3/p01 or 3/01) or a printer."""
    if target.isdigit():
        return f"/jobs/{target}"
    if re.fullmatch(r"\d+/p?\d+[a-z]*", target):
        job, _, part = target.partition("/")
        return f"/jobs/{job}/parts/{part}"
    return f"/printers/{target}"


def select_beds_to_clear(printers: Iterable[PrinterView]) -> list[str]:
    """Select the printers that `all` means.

    Not those in maintenance or absent: a part may still lie there.
    """
    others = (HoldCode.MAINTENANCE, Link.ABSENT)
    return [p.name for p in printers if p.print is None and p.hold is not None and p.state not in others]


@placed
def cleared(
    places: Places,
    printers: Annotated[
        list[str],
        typer.Argument(
            help="The printers whose beds are clear, or `all` that wait for it.",
            autocompletion=completion.beds,
        ),
    ],
    bad: Annotated[bool, typer.Option("--bad", help="The printed part is bad: print it again.")] = False,
    why: Annotated[str | None, typer.Option(help="What is wrong with the part; implies --bad.")] = None,
    good: Annotated[
        str | None,
        typer.Option(metavar="PART", help="This part of a failed print is good: do not print it again."),
    ] = None,
    filament: Annotated[
        FilamentState | None, typer.Option(help="Where the tip of the filament is, if known.")
    ] = None,
) -> None:
    """Confirm that beds are clear, printers inspected, and the parts printed there good (or --bad)."""
    if good is not None and (bad or why is not None):
        raise typer.BadParameter("--good and --bad (or --why) exclude each other", param_hint="--good")
    if good is not None and (len(printers) != 1 or printers == ["all"]):
        raise typer.BadParameter(
            "give exactly one printer: the one that printed the part", param_hint="--good"
        )
    client = Client(places.socket)
    fleet_now = {p.name: p for p in client.status().printers}
    if printers == ["all"]:
        if bad:
            raise typer.BadParameter("give the printers whose parts are bad, not all", param_hint="--bad")
        printers = select_beds_to_clear(fleet_now.values())
        if not printers:
            print("no bed waits to be cleared")
    unknown = [name for name in printers if name not in fleet_now]
    if unknown:
        raise NoSuchThing(f"there is no printer {' '.join(unknown)}; the fleet has {' '.join(fleet_now)}")
    request = ClearedRequest(filament=filament, bad=bad or why is not None, why=why, good=good)
    for printer in printers:
        answer = client.cleared(printer, request)
        print("; ".join((f"{printer}: bed clear", *_describe_part(request, answer))))


def _describe_part(request: ClearedRequest, answer: Cleared) -> list[str]:
    """Say what happens to the part that was on the bed."""
    if request.bad and answer.again is None:
        return ["its part was cancelled and is not printed again"]
    if request.bad:
        return [f"part {answer.again} will be printed again"]
    if answer.good is None:
        return []
    reprints = [
        f"{name} already prints it again: stop that with `farm cancel {name}`" for name in answer.printed_on
    ]
    return [f"part {answer.good} is good" + ("" if reprints else " and will not be printed again"), *reprints]


@placed
def fail(places: Places, printer: Printer, why: Why = "") -> None:
    """End a failing print safely, and print its part again."""
    Client(places.socket).tell(f"/printers/{printer}/fail", why)
    print(
        f"{printer}: its print ends, its part will be printed again; remove it, then `farm cleared {printer}`"
    )


@placed
def reprint(
    places: Places,
    job: Job,
    part: Annotated[
        str, typer.Argument(help="The part, as shown by `farm status JOB`.", autocompletion=completion.parts)
    ],
    why: Why = "",
) -> None:
    """Print a part again, at any time and whatever its state."""
    path = f"/jobs/{job}/parts/{part.rpartition('/')[2]}/reprint"
    name = Client(places.socket).tell(path, why)
    print(f"part {name} will be printed again")


@placed
def cancel(
    places: Places,
    target: Target,
) -> None:
    """Cancel a job or a part: prints end safely, and nothing of it is printed again."""
    client = Client(places.socket)
    if not target.isdigit():
        name = client.tell(f"{target_path(target)}/cancel")
        print(
            f"part {name} is cancelled; if it was being printed, clear the bed, then `farm cleared PRINTER`"
        )
        return
    answer = client.cancel(int(target))
    printing = sorted({plate.printer for plate in answer.job.plates if plate.printing})
    print(f"job {target} is cancelled{_ending(printing)}")


def _ending(printing: list[str]) -> str:
    if not printing:
        return ""
    prints = "prints end" if len(printing) > 1 else "print ends"
    return f"; {' '.join(printing)}: the {prints} safely; remove the parts, then `farm cleared PRINTER`"


@placed
def maintenance(
    places: Places,
    printer: Printer,
    why: Why = "",
    done: Annotated[bool, typer.Option("--done", help="Put it back into use.")] = False,
) -> None:
    """Take a printer out of use after its current print, or put it back into use (--done)."""
    client = Client(places.socket)
    if done:
        client.tell(f"/printers/{printer}/maintained")
        print(f"{printer}: back in use")
    elif not why:
        raise typer.BadParameter("give the reason; it is shown to others", param_hint="--why")
    else:
        client.tell(f"/printers/{printer}/maintenance", why)
        print(f"{printer}: in maintenance; put it back into use with `farm maintenance {printer} --done`")
