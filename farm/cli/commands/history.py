"""`farm history` and `farm report`: what was printed, how long it took, and what was wasted."""

from __future__ import annotations

import os
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from farm import api
from farm.cli import completion
from farm.cli.client.daemon_client import Client
from farm.cli.display.console import console, table
from farm.cli.display.format import moment, off_plan, say
from farm.cli.options import Job, Json, placed
from farm.errors import FarmError
from farm.paths import Places
from farm.text import count, mass, span

_ALL = 100_000


@placed
def history(
    places: Places,
    job: Annotated[int | None, typer.Option(help="Only of this job.", autocompletion=completion.jobs)] = None,
    printer: Annotated[
        str | None, typer.Option(help="Only on this printer.", autocompletion=completion.printers)
    ] = None,
    last: Annotated[int, typer.Option(min=1, max=_ALL, help="How many.")] = 30,
    json: Json = False,
) -> None:
    """The prints that ended last: how long each took, against its plan, and what became of it."""
    past = Client(places.socket).history(job, printer, last)
    if json:
        print(past.model_dump_json(by_alias=True, indent=2))
        return
    rows = table("ENDED", "PRINTER", "PART", "MODEL", "TOOK", "VS PLAN", "USED", "BY", "OUTCOME")
    for row in past.prints:
        done = row.state == "done" and row.expected_s
        off = off_plan(row.took_s / row.expected_s - 1) if done else ""
        why = row.why if row.verdict else row.reason or row.fault
        outcome = str(row.verdict or row.state) + (f": {why}" if why and row.wasted else "")
        used = f"{mass(row.grams)}{' wasted' if row.wasted and row.grams >= 0.5 else ''}"
        name = row.name[:20]
        took, by = span(row.took_s), row.submitted_by or ""
        rows.add_row(moment(row.ended), row.printer, row.part, name, took, off, used, by, outcome)
    screen = console()
    screen.print(rows)
    lost = [row for row in past.prints if row.wasted]
    screen.print(
        f"{count(len(past.prints), 'print')}, {len(lost)} of them wasted: "
        f"{span(sum(row.took_s for row in lost))}, {mass(sum(row.grams for row in lost))}"
    )


@placed
def report(
    places: Places,
    job: Job,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="The file; else job-N.html here.")] = None,
) -> None:
    """Write one HTML page on a job: its figures, the Gantt of the fleet, what failed and why, its parts."""
    from farm.views.part_pictures import draw_part
    from farm.views.report import render_page

    client = Client(places.socket)
    view = client.job(job).job
    now = datetime.fromisoformat(client.status().fleet.now)
    pictures = {part.id: png for part in view.parts if (png := draw_part(Path(part.file))) is not None}
    whole = Path(view.folder) / "assembly.png" if view.folder else None
    seen = whole is not None and os.access(whole, os.R_OK)
    assembly = whole.read_bytes() if whole is not None and seen and len(view.parts) > 1 else None
    target = out or Path(f"job-{job}.html")
    text = render_page(view, client.history(None, None, _ALL).prints, now, facts(view), pictures, assembly)
    try:
        target.write_text(text, encoding="utf-8")
    except OSError as error:
        why = error.strerror or error
        raise FarmError(f"{target} cannot be written ({why}); name another file with --out") from error
    if view.parts and not pictures and not seen:
        say(f"{view.folder} is not yours to read: the page has no pictures")
    print(target)


def facts(view: api.JobView) -> list[tuple[str, str]]:
    """A job's figures, as a person reads them."""
    reached = "reached" if view.state in ("printed", "done") else "by what is known now"
    rows = [
        ("submitted", moment(view.submitted) + (f" by {view.submitted_by}" if view.submitted_by else "")),
        ("plates printed", f"{view.printed} of {len(view.plates)}; good {view.good}"),
        ("parallel printing time expected", span(view.estimated_s)),
        (f"parallel printing time {reached}", span(view.current_s)),
        ("on one imagined large printer", span(view.serial_s)),
        ("speed-up", f"{view.speedup:.1f}" if view.speedup else "-"),
        ("utilisation", f"{view.utilisation:.0%}" if view.utilisation else "-"),
        ("wasted", f"{span(view.wasted_s)}, {mass(view.wasted_grams)}" if view.wasted_s else "nothing"),
        ("filament", mass(view.grams) if view.grams is not None else "-"),
    ]
    if view.price is not None:
        rows.append(("price of the filament", f"{view.price:.2f} {view.currency or ''}".strip()))
    return rows
