"""Commands on jobs and printers: `cleared`, `fail`, `reprint`, `cancel`, `pause`, `resume`, `load`, ..."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated

import typer

from farm.api import AssembledRequest, ClearedRequest, ClearedResponse, LoadRequest, PrinterView
from farm.cli import completion
from farm.cli.client import connect
from farm.cli.display import print_json
from farm.cli.options import Job, Json, Printer, ReasonOption, with_farm
from farm.errors import NotFoundError
from farm.model import FilamentState, HoldCode, Link
from farm.paths import FarmPaths
from farm.text import format_duration
from farm.wording import describe_material

Targets = Annotated[
    list[str], typer.Argument(help="Printers, jobs (3) or parts (3/p01).", autocompletion=completion.targets)
]
OptionalTargets = Annotated[
    list[str] | None,
    typer.Argument(
        help="Printers, jobs (3) or parts (3/p01); default: the whole farm after an outage.",
        autocompletion=completion.targets,
    ),
]
Target = Annotated[
    str,
    typer.Argument(
        help="A job (3), a part (3/p01), or a printer (its print).", autocompletion=completion.targets
    ),
]


def find_target_path(target: str) -> str:
    """Return the HTTP path of a job (3), a part (3/p01 or 3/01) or a printer."""
    if target.isdigit():
        return f"/jobs/{target}"
    if re.fullmatch(r"\d+/p?\d+(\.\d+)?[a-z]*", target):
        job, _, part = target.partition("/")
        return f"/jobs/{job}/parts/{part}"
    return f"/printers/{target}"


def select_printers_to_clear(printers: Iterable[PrinterView]) -> list[str]:
    """Select the printers that `farm cleared all` means: those that wait for their beds to be cleared.

    Absent printers and those in maintenance are left out, because parts may still be on their beds.
    """
    excluded_states = (HoldCode.MAINTENANCE, Link.ABSENT)
    return [
        p.name for p in printers if p.print is None and p.hold is not None and p.state not in excluded_states
    ]


@with_farm
def cleared(
    paths: FarmPaths,
    printers: Annotated[
        list[str],
        typer.Argument(
            help="The printers whose beds are clear; `all`: every printer that waits for this.",
            autocompletion=completion.beds,
        ),
    ],
    bad: Annotated[bool, typer.Option("--bad", help="The printed part is bad: print it again.")] = False,
    why: Annotated[str | None, typer.Option(help="Why the part is bad; implies --bad.")] = None,
    good: Annotated[
        str | None,
        typer.Option(metavar="PART", help="This part of a failed print is good: do not print it again."),
    ] = None,
    filament: Annotated[
        FilamentState | None, typer.Option(help="Position of the filament's tip, if known.")
    ] = None,
) -> None:
    """Confirm that beds are clear, printers inspected, and their printed parts good (or --bad)."""
    if good is not None and (bad or why is not None):
        raise typer.BadParameter("--good and --bad (or --why) exclude each other", param_hint="--good")
    if good is not None and (len(printers) != 1 or printers == ["all"]):
        raise typer.BadParameter(
            "give exactly one printer: the one that printed the part", param_hint="--good"
        )
    client = connect(paths)
    fleet = {p.name: p for p in client.fetch_status_summary().printers}
    if printers == ["all"]:
        if bad:
            raise typer.BadParameter("give the printers whose parts are bad, not all", param_hint="--bad")
        printers = select_printers_to_clear(fleet.values())
        if not printers:
            print("no bed needs clearing")
    unknown = [name for name in printers if name not in fleet]
    if unknown:
        raise NotFoundError(f"there is no printer {' '.join(unknown)}; the fleet has {' '.join(fleet)}")
    request = ClearedRequest(filament=filament, bad=bad or why is not None, why=why, good=good)
    for printer in printers:
        response = client.clear_bed(printer, request)
        print("; ".join((f"{printer}: bed clear", *_describe_part_outcome(request, response))))


def _describe_part_outcome(request: ClearedRequest, response: ClearedResponse) -> list[str]:
    """Describe the outcome for the part that was on the bed: printed again, cancelled, or good."""
    if request.bad and response.again is None:
        return ["its part was cancelled and is not printed again"]
    if request.bad:
        return [f"part {response.again} will be printed again"]
    if response.good is None:
        return []
    reprints = [
        f"{name} is already printing it again: stop that with `farm cancel {name}`"
        for name in response.printed_on
    ]
    return [
        f"part {response.good} is good" + ("" if reprints else " and will not be printed again"),
        *reprints,
    ]


@with_farm
def fail(paths: FarmPaths, printer: Printer, why: ReasonOption = "") -> None:
    """End a failing print safely, and print its part again."""
    connect(paths).send_command(f"/printers/{printer}/fail", why)
    print(
        f"{printer}: its print ends, and its part will be printed again; remove the failed part, then "
        f"`farm cleared {printer}`"
    )


@with_farm
def reprint(
    paths: FarmPaths,
    job: Job,
    part: Annotated[
        str, typer.Argument(help="The part, as shown by `farm status JOB`.", autocompletion=completion.parts)
    ],
    why: ReasonOption = "",
) -> None:
    """Print a part again, even if it was printed or cancelled, or failed too often."""
    path = f"/jobs/{job}/parts/{part.rpartition('/')[2]}/reprint"
    name = connect(paths).send_command(path, why)
    print(f"part {name} will be printed again")


@with_farm
def cancel(
    paths: FarmPaths,
    target: Target,
) -> None:
    """Cancel a job or a part: its prints end safely, and it is not printed again."""
    client = connect(paths)
    if not target.isdigit():
        name = client.send_command(f"{find_target_path(target)}/cancel")
        print(
            f"part {name} is cancelled; if it was being printed, clear the bed, then `farm cleared PRINTER`"
        )
        return
    response = client.cancel_job(int(target))
    printers = sorted({plate.printer for plate in response.job.plates if plate.printing})
    print(f"job {target} is cancelled{_describe_ending(printers)}")


def _describe_ending(printing_printers: list[str]) -> str:
    if not printing_printers:
        return ""
    prints = "prints end" if len(printing_printers) > 1 else "print ends"
    return (
        f"; {' '.join(printing_printers)}: the {prints} safely; remove the parts, then `farm cleared PRINTER`"
    )


@with_farm
def pause(paths: FarmPaths, targets: Targets) -> None:
    """Pause prints, or a whole job: the head moves aside, the nozzle cools, and the bed stays warm.

    A print that is not resumed within two hours is ended. Waiting parts of a paused job do not start.
    """
    client = connect(paths)
    for target in targets:
        path = find_target_path(target)
        printer = client.send_command(f"{path}/pause")
        effect = "pausing; none of its waiting parts will start" if target.isdigit() else "pausing"
        if "/parts/" in path:
            effect = f"pausing on {printer}" if printer else "will not start"
        print(f"{_format_target(target)}: {effect}; continue with `farm resume {target}`")


@with_farm
def resume(paths: FarmPaths, targets: OptionalTargets = None) -> None:
    """Resume a paused job, part or printer; without a name, the whole farm after an outage."""
    client = connect(paths)
    if not targets:
        printers = client.send_command("/outage/confirm")
        print(
            f"the farm continues; inspect the lost printers ({printers}), "
            "then `farm cleared PRINTER` for each"
        )
    for target in targets or ():
        client.send_command(f"{find_target_path(target)}/resume")
        print(f"{_format_target(target)}: resumed")
    for task in client.fetch_status_summary().todo:
        if task.code == "hours":  # a resumed print will be ended when the attended hours end
            print(task.text)


def _format_target(target: str) -> str:
    return f"job {target}" if target.isdigit() else target


@with_farm
def load(
    paths: FarmPaths,
    printer: Printer,
    filament: Annotated[
        str | None, typer.Argument(help="The new reel: a material, with or without its colour: 'black PLA'.")
    ] = None,
    material: Annotated[
        str | None, typer.Option(help="Material of the new reel: PLA, or Cura's name of a material.")
    ] = None,
    colour: Annotated[str | None, typer.Option(help="Colour of the new reel.")] = None,
    grams: Annotated[float | None, typer.Option(help="Filament on the new reel, g.", min=0)] = None,
    nozzle: Annotated[float | None, typer.Option(help="Size of the mounted nozzle, mm.", min=0.1)] = None,
) -> None:
    """Record a new reel or nozzle. No print starts with too little filament left."""
    if filament is not None and material is not None:
        raise typer.BadParameter("give the material only once", param_hint="--material")
    material = filament or material
    if material is None and colour is None and grams is None and nozzle is None:
        raise typer.BadParameter("give the filament, or one of --material, --colour, --grams and --nozzle")
    request = LoadRequest(material=material, colour=colour, grams=grams, nozzle_mm=nozzle)
    reel = connect(paths).load_reel(printer, request)
    amount = f", {reel.grams:.0f} g" if reel.grams is not None else ", amount not known"
    colour_and_kind = " ".join(filter(None, (reel.colour, describe_material(reel.material, reel.kind))))
    print(f"{printer}: {colour_and_kind}{amount}, nozzle {reel.nozzle_mm:g} mm")


@with_farm
def maintenance(
    paths: FarmPaths,
    printer: Printer,
    why: ReasonOption = "",
    done: Annotated[bool, typer.Option("--done", help="Put it back into use.")] = False,
) -> None:
    """Take a printer out of use after its current print, or put it back into use (--done)."""
    client = connect(paths)
    if done:
        client.send_command(f"/printers/{printer}/maintained")
        print(f"{printer}: back in use")
    elif not why:
        raise typer.BadParameter("give the reason; it is shown to others", param_hint="--why")
    else:
        client.send_command(f"/printers/{printer}/maintenance", why)
        print(f"{printer}: in maintenance; put it back into use with `farm maintenance {printer} --done`")


@with_farm
def assembled(
    paths: FarmPaths,
    job: Job,
    minutes: Annotated[float, typer.Option(min=0.1, max=10_000, help="Duration of the gluing, in minutes.")],
    json: Json = False,
) -> None:
    """Report that the parts of a job are glued, and how long that took."""
    response = connect(paths).record_assembly(job, AssembledRequest(minutes=minutes))
    if json:
        print_json(response)
        return
    total_s = response.job.submitted_to_assembled_s
    print(
        f"job {job}: assembled in {format_duration(60.0 * minutes)}"
        + (f", {format_duration(total_s)} after its submission" if total_s is not None else "")
    )
