"""`farm status`, `farm history` and `farm report`: commands that change nothing."""

from __future__ import annotations

import os
import time
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType
from rich.live import Live

from farm import api
from farm.cli import completion
from farm.cli.client import Client, connect
from farm.cli.display import (
    Column,
    format_copies,
    format_deviation,
    format_runs,
    format_share,
    format_time,
    lay_out_table,
    open_console,
    parse_time,
    print_json,
    render_job,
    render_status,
    retry_over_restart,
    show_job,
    terminal_width,
)
from farm.cli.notices import print_notice
from farm.cli.options import Job, Json, with_farm, with_places
from farm.errors import FarmError
from farm.paths import Places
from farm.text import format_count, format_duration, format_mass

_REFRESH_S = 1.0
_ALL = 100_000
_STILLS_BYTES = 50_000_000  # of all stills on a page
_HISTORY = (
    Column("ENDED"),
    Column("PRINTER"),
    Column("PART"),
    Column("MODEL", rank=2, least=10),
    Column("DURATION", rank=3),
    Column("VS PLAN", rank=4),
    Column("USED", rank=5),
    Column("BY", rank=6),
    Column("OUTCOME", rank=1, least=16),
)
_NOTE = Column("NOTE", rank=7, least=10)


@with_farm
def status(
    places: Places,
    job: Annotated[int | None, typer.Argument(help="Only this job.", autocompletion=completion.jobs)] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Refresh every second until Ctrl-C.")] = False,
    json: Json = False,
) -> None:
    """Show what you have to do now, the printers, the jobs, and why each waiting plate waits."""
    client = connect(places)
    if watch and not json:
        _watch(client, job)
    elif job is not None:
        answer = client.job(job)
        print_json(answer) if json else show_job(answer.job)
    else:
        view = client.status()
        screen = open_console()
        print_json(view) if json else screen.print(render_status(view, terminal_width(screen)))


def _watch(client: Client, number: int | None) -> None:
    """Refresh the page every second until Ctrl-C, which leaves the last one on the terminal."""
    screen = open_console()

    def draw(height: int | None) -> RenderableType:
        if number is not None:
            return render_job(client.job(number).job, screen.width)
        return render_status(client.status(), screen.width, height)

    # The size is queried each time: a terminal may be resized.
    try:
        with Live(console=screen, auto_refresh=False, screen=True, vertical_overflow="crop") as live:
            while True:
                live.update(retry_over_restart(lambda: draw(screen.height)), refresh=True)
                time.sleep(_REFRESH_S)
    finally:
        screen.print(retry_over_restart(lambda: draw(None)))


@with_farm
def history(
    places: Places,
    job: Annotated[
        int | None, typer.Option(help="Only prints of this job.", autocompletion=completion.jobs)
    ] = None,
    printer: Annotated[
        str | None, typer.Option(help="Only prints on this printer.", autocompletion=completion.printers)
    ] = None,
    last: Annotated[int, typer.Option(min=1, max=_ALL, help="Number of prints.")] = 30,
    json: Json = False,
) -> None:
    """List the latest prints: duration, deviation from the plan, filament and outcome."""
    answer = connect(places).history(job, printer, last)
    if json:
        print_json(answer)
        return
    if not answer.prints:
        print("no print has ended")
        return
    rows, now = [], answer.now
    noted = any(row.note for row in answer.prints)
    for row in answer.prints:
        printed = row.state == "done" and row.expected_s
        deviation = format_deviation(row.took_s / row.expected_s - 1) if printed else ""
        reason = row.why if row.verdict else row.reason or row.fault
        outcome = str(row.verdict or row.state) + (f": {reason}" if reason and row.wasted else "")
        used = f"{format_mass(row.grams)}{' wasted' if row.wasted and row.grams >= 0.5 else ''}"
        ended, duration, by = format_time(row.ended, now), format_duration(row.took_s), row.submitted_by or ""
        name = row.name[:20]
        cells = (ended, row.printer, row.part, name, duration, deviation, used, by, outcome)
        rows.append((*cells, row.note or "") if noted else cells)
    screen = open_console()
    columns = (*_HISTORY, _NOTE) if noted else _HISTORY
    for line in lay_out_table(columns, rows, terminal_width(screen)):
        screen.print(line)
    wasted = [row for row in answer.prints if row.wasted]
    grams = sum(row.grams for row in wasted)
    screen.print(
        f"{format_count(len(answer.prints), 'print')}, {len(wasted)} of them wasted: "
        f"{format_duration(sum(row.took_s for row in wasted))}, {format_mass(grams)}"
    )


@with_places
def report(
    places: Places,
    job: Job,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The file to write; default job-N.html in this folder.")
    ] = None,
) -> None:
    """Write an HTML page on a job: its figures, a Gantt chart, what failed and why, and its parts."""
    from farm.views.report import render_page  # slow to load

    client = Client(places.socket)
    view = client.job(job).job
    now = datetime.fromisoformat(client.status().fleet.now)
    part_by_files = {(part.file, part.picture): part for part in view.parts}  # copies of a part share both
    picture_by_files = {files: _find_picture(part) for files, part in part_by_files.items()}
    pictures = {
        part.id: png for part in view.parts if (png := picture_by_files[part.file, part.picture]) is not None
    }
    pictures |= _read_stills(view)
    assembly = Path(view.folder) / "assembly.png" if view.folder else None
    readable = assembly is not None and os.access(assembly, os.R_OK)
    target = out or Path(f"job-{job}.html")
    text = render_page(
        view,
        client.history(None, None, _ALL).prints,
        now,
        list_figures(view),
        pictures,
        assembly.read_bytes() if assembly is not None and readable and len(view.parts) > 1 else None,
    )
    try:
        target.write_text(text, encoding="utf-8")
    except OSError as error:
        cause = error.strerror or error
        raise FarmError(f"{target} cannot be written ({cause}); give another file with --out") from error
    if view.parts and not pictures and not readable:
        print_notice(f"you may not read {view.folder}: the page has no pictures")
    print(target)


def _find_picture(part: api.PartView) -> bytes | None:
    """Draw a part, or read the picture that was kept of it; None if neither can be read."""
    from farm.upkeep.part_pictures import draw_part

    if part.file is not None:
        return draw_part(Path(part.file))
    if part.picture is not None and os.access(part.picture, os.R_OK):
        return Path(part.picture).read_bytes()
    return None


def _read_stills(view: api.JobView) -> dict[str, bytes]:
    """Read the stills of a job's prints by their paths, the first ones of too many."""
    stills: dict[str, bytes] = {}
    left_bytes = _STILLS_BYTES
    for path in [still.file for one in view.prints for still in one.stills if still.file is not None]:
        if os.access(path, os.R_OK) and (left_bytes := left_bytes - Path(path).stat().st_size) >= 0:
            stills[path] = Path(path).read_bytes()
    return stills


def list_figures(view: api.JobView) -> list[tuple[str, str]]:
    """List the figures of a job, each with its name."""
    actual = "actual" if view.state in ("printed", "done") else "as known now"
    rows = [
        (
            "submitted",
            f"{parse_time(view.submitted):%a %d %b %Y %H:%M}"
            + (f" by {view.submitted_by}" if view.submitted_by else ""),
        ),
        ("plates printed", f"{view.printed} of {len(view.plates)}; good {view.good}"),
        ("parallel printing time, expected", format_duration(view.estimated_s)),
        (f"parallel printing time, {actual}", format_duration(view.current_s)),
        ("single large printer", format_duration(view.serial_s)),
        ("speed-up", f"{view.speedup:.1f}" if view.speedup else "-"),
        ("utilisation", format_share(view.utilisation) if view.utilisation else "-"),
        (
            "wasted",
            f"{format_duration(view.wasted_s)}, {format_mass(view.wasted_grams)}"
            if view.wasted_s
            else "nothing",
        ),
        ("filament", format_mass(view.grams) if view.grams is not None else "-"),
    ]
    if view.options.note:
        rows.insert(1, ("note", view.options.note))
    if view.options.copies > 1:
        rows.insert(1, ("copies printed", format_copies(view)))
    if len(view.runs) > 1:
        rows.append(
            ("printed in runs", f"{format_runs(view.runs, view.now)}; the time between them is not counted")
        )
    if view.pruned is not None:
        rows.append(("files", f"pruned on {format_time(view.pruned, view.now)}"))
    if view.price is not None:
        rows.append(("price of the filament", f"{view.price:.2f} {view.currency or ''}".strip()))
    return rows
