"""Tables and sentences for people. Everything shown here is in `--json` too."""

from __future__ import annotations

import time

from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from farm import api
from farm.cli.client.daemon_client import Client
from farm.cli.display.console import console, table
from farm.cli.display.format import filament, from_cache, moment, planning
from farm.cli.display.progress import patiently
from farm.cli.display.status_page import board
from farm.model import JobState, PrintState
from farm.text import mass, span

_REFRESH_S = 1.0


def status(view: api.Status) -> None:
    screen = console()
    screen.print(board(view, screen.width))


def job(view: api.JobView) -> None:
    console().print(_job(view))


def watch(client: Client, number: int | None) -> None:
    """Show the status anew every second until Ctrl-C."""
    screen = console()

    def draw() -> RenderableType:
        if number is not None:
            return _job(client.job(number).job)
        return board(client.status(), screen.width)

    with Live(patiently(draw), console=screen, auto_refresh=False, screen=False) as live:
        while True:
            time.sleep(_REFRESH_S)
            live.update(patiently(draw), refresh=True)


def submitted(view: api.JobView, wait: bool) -> None:
    """What was done to a model to make a job of it; how to follow it, where nobody waits for it."""
    screen = console()
    screen.print(f"job {view.id}: {view.name} submitted")
    for line in _changes(view):
        screen.print(_change(line))
    if not wait:
        if view.hold is not None:
            screen.print(f"  waits: {view.hold.text}")
        screen.print(f"  `farm status {view.id}` shows how it goes")


def _changes(view: api.JobView) -> list[str]:
    """What the farm did to the model."""
    scaled = [f"Scaled by {view.scale:g}."] if view.scale is not None and view.scale != 1 else []
    return [*view.repairs, *scaled]


def _change(line: str) -> Text:
    return Text(f"  {line}", style="yellow" if line.startswith("Warning: ") else "")


def result(view: api.JobView) -> None:
    """The end of a job."""
    screen = console()
    screen.print(_job(view))
    if view.state in (JobState.PRINTED, JobState.DONE):
        printers = " ".join(sorted({plate.printer for plate in view.plates}))
        screen.print(f"Now: take the parts off, then `farm cleared {printers}`.")


def _job(view: api.JobView) -> RenderableType:
    rows: list[RenderableType] = [Text(f"Job {view.id}: {view.name}, {view.state}", style="bold")]
    if view.reason:
        rows.append(Text(f"  {view.reason}", style="red"))
    rows += [_change(line) for line in _changes(view)]
    rows += [
        Text(f"  plate {plate.id}: {line}", style="yellow")
        for plate in view.plates
        for line in plate.warnings
    ]
    facts = Table.grid(padding=(0, 2, 0, 0))
    facts.add_column(no_wrap=True)
    facts.add_column(overflow="fold")
    if view.submitted_by is not None:
        facts.add_row("submitted", f"{moment(view.submitted)} by {view.submitted_by}")
    if view.progress is not None:
        facts.add_row("planning", planning(view.progress))
    if view.plan is not None and view.state == JobState.HELD:
        facts.add_row("plan", view.plan)
    if cached := sum(plate.cached for plate in view.plates):
        facts.add_row("sliced before", from_cache(cached))
    if view.estimated_s is not None:
        facts.add_row("parallel printing time expected", span(view.estimated_s))
    if view.elapsed_s is not None:
        reached = view.state in (JobState.PRINTED, JobState.DONE)
        ended = "parallel printing time reached" if reached else "printed for"
        words = ended if view.state.ended else "printing for"
        off = ""
        if reached and view.estimated_s:
            off = f"  ({view.elapsed_s / view.estimated_s - 1:+.1%} against expected)"
        facts.add_row(words, span(view.elapsed_s) + off)
    if view.eta and view.state == JobState.PRINTING:
        facts.add_row("ends", moment(view.eta))
    if view.serial_s is not None:
        facts.add_row("on one imagined large printer", span(view.serial_s))
    if view.speedup is not None:
        facts.add_row("speed-up", f"{view.speedup:.1f}")
    if view.utilisation is not None:
        facts.add_row("utilisation", f"{view.utilisation:.0%}")
    if view.wasted_s > 0:
        facts.add_row("wasted", f"{span(view.wasted_s)}, {mass(view.wasted_grams)}")
    if view.grams is not None and view.filament_mm is not None:
        facts.add_row("filament", filament(view.grams, view.filament_mm, view.price, view.currency))
    if view.starved_share is not None and view.starved_share > 0.01:
        facts.add_row(
            "not valid", f"simulated printers waited {view.starved_share:.1%} of the time for the host"
        )
    rows.append(facts)
    if view.parts:
        parts = table("PART", "PRINTER", "STATE", "EXPECTED", "STARTED", "ENDED", "FILAMENT")
        plates = {plate.id: plate for plate in view.plates}
        for part in view.parts:
            plate = plates[part.plate]
            last = part.own_prints[-1] if part.own_prints else None
            parts.add_row(
                part.id,
                plate.printer,
                _outcome(part),
                span(plate.estimated_s),
                moment(last.started if last else None),
                moment(last.ended if last else None),
                filament(plate.grams, plate.filament_mm, plate.price, view.currency),
            )
        rows.append(parts)
    if view.folder:
        rows.append(Text(f"parts (STL), plates (G-code), a picture and a GLB of them: {view.folder}"))
    for one in view.prints:
        if one.fault or one.why:
            why = one.reason or one.why or one.fault
            rows.append(Text(f"part {one.part} on {one.printer}, {moment(one.ended)}: {why}", style="red"))
    rows += _waits(view)
    return Group(*rows)


def _outcome(part: api.PartView) -> str:
    """Where a part is, with a person's word on it."""
    prints = part.own_prints
    if not prints:
        return "waits"
    last = prints[-1]
    state = str(part.verdict) if part.verdict and last.state == PrintState.DONE else str(last.state)
    tries = f", print {len(prints)}" if len(prints) > 1 else ""
    return state + tries


def _waits(view: api.JobView) -> list[RenderableType]:
    lines = []
    if view.hold is not None:
        lines.append(Text(f"job {view.id} waits: {view.hold.text}", style="yellow"))
    lines += [
        Text(f"plate {plate.id} waits: {plate.hold.text}", style="yellow")
        for plate in view.plates
        if plate.hold is not None
    ]
    return list(lines)
