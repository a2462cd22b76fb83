"""`farm status`, `farm history`, `farm report` and `farm hosts`: show the current state and past prints."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from rich.console import Console, RenderableType
from rich.live import Live

from farm import api
from farm.cli import completion
from farm.cli.client import Client, connect
from farm.cli.display import (
    Column,
    lay_out_table,
    open_console,
    print_json,
    read_terminal_width,
    render_job,
    render_status,
    retry_during_restart,
    show_job,
)
from farm.cli.notices import print_notice
from farm.cli.options import Job, Json, with_farm
from farm.errors import FarmError
from farm.paths import FarmPaths
from farm.text import format_count, format_duration, format_mass
from farm.wording import format_deviation, format_time

_REFRESH_INTERVAL_S = 1.0
_MAX_ROWS = 100_000
_HISTORY_COLUMNS = (
    Column("ENDED"),
    Column("PRINTER"),
    Column("PART"),
    Column("MODEL", rank=2, min_width=10),
    Column("DURATION", rank=3),
    Column("VS PLAN", rank=4),
    Column("USED", rank=5),
    Column("BY", rank=6),
    Column("OUTCOME", rank=1, min_width=16),
)
_HOST_COLUMNS = (
    Column("HOST"),
    Column("CONNECTED"),
    Column("VERSION", rank=4),
    Column("PRINTING", rank=3),
    Column("AGENTS", rank=2),
    Column("PORTS", rank=5),
    Column("WAITS FOR", rank=1, min_width=16),
)
_SPEED_COLUMNS = (
    Column("PRINTER"),
    Column("FACTOR"),
    Column("WALLS", rank=1),
    Column("INFILL", rank=2),
    Column("SKINS", rank=1),
    Column("SUPPORTS", rank=3),
    Column("TRAVEL", rank=1),
    Column("LEARNED FROM", rank=1),
)
_NOTE_COLUMN = Column("NOTE", rank=7, min_width=10)


@with_farm
def status(
    paths: FarmPaths,
    job: Annotated[int | None, typer.Argument(help="Only this job.", autocompletion=completion.jobs)] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Refresh every second until Ctrl-C.")] = False,
    json: Json = False,
) -> None:
    """Show what you have to do now, the printers, the jobs, and why each waiting plate waits."""
    client = connect(paths)
    if watch and not json:
        _watch_status(client, job)
    elif job is not None:
        response = client.fetch_job(job)
        print_json(response) if json else show_job(response.job)
    else:
        _show_farm(client, json)


def _show_farm(client: Client, as_json: bool) -> None:
    if as_json:
        print_json(client.fetch_status())
        return
    screen = open_console()
    screen.print(render_status(client.fetch_status_summary(), read_terminal_width(screen)))


def _watch_status(client: Client, number: int | None) -> None:
    """Refresh the status page every second until Ctrl-C, and leave the last page on the terminal."""
    screen = open_console()

    def draw(height: int | None) -> RenderableType:
        if number is not None:
            return render_job(client.fetch_job(number).job, screen.width)
        return render_status(client.fetch_status_summary(), screen.width, height)

    # The size is read for each page, because the terminal may be resized.
    try:
        with Live(console=screen, auto_refresh=False, screen=True, vertical_overflow="crop") as live:
            while True:
                live.update(retry_during_restart(lambda: draw(screen.height)), refresh=True)
                time.sleep(_REFRESH_INTERVAL_S)
    finally:
        screen.print(retry_during_restart(lambda: draw(None)))


@with_farm
def history(
    paths: FarmPaths,
    job: Annotated[
        int | None, typer.Option(help="Only prints of this job.", autocompletion=completion.jobs)
    ] = None,
    printer: Annotated[
        str | None, typer.Option(help="Only prints on this printer.", autocompletion=completion.printers)
    ] = None,
    last: Annotated[int, typer.Option(min=1, max=_MAX_ROWS, help="Number of prints.")] = 30,
    json: Json = False,
) -> None:
    """List the latest prints: duration, deviation from the plan, filament and outcome."""
    response = connect(paths).fetch_history(job, printer, last)
    if json:
        print_json(response)
        return
    if not response.prints:
        print("no print has ended")
        return
    rows, now = [], response.now
    has_notes = any(row.note for row in response.prints)
    for row in response.prints:
        is_printed = row.state == "done" and row.expected_s
        deviation = format_deviation(row.took_s / row.expected_s - 1) if is_printed else ""
        reason = row.why if row.verdict else row.reason or row.fault
        outcome = str(row.verdict or row.state) + (f": {reason}" if reason and row.wasted else "")
        used_mass = f"{format_mass(row.grams)}{' wasted' if row.wasted and row.grams >= 0.5 else ''}"
        end_time, duration, submitter = (
            format_time(row.ended, now),
            format_duration(row.took_s),
            row.submitted_by or "",
        )
        name = row.name[:20]
        cells = (end_time, row.printer, row.part, name, duration, deviation, used_mass, submitter, outcome)
        rows.append((*cells, row.note or "") if has_notes else cells)
    screen = open_console()
    columns = (*_HISTORY_COLUMNS, _NOTE_COLUMN) if has_notes else _HISTORY_COLUMNS
    for line in lay_out_table(columns, rows, read_terminal_width(screen)):
        screen.print(line)
    wasted_rows = [row for row in response.prints if row.wasted]
    grams = sum(row.grams for row in wasted_rows)
    screen.print(
        f"{format_count(len(response.prints), 'print')}, {len(wasted_rows)} of them wasted: "
        f"{format_duration(sum(row.took_s for row in wasted_rows))}, {format_mass(grams)}"
    )
    _show_speeds(response.speeds, screen)


def _show_speeds(speeds: Sequence[api.PrinterSpeed], screen: Console) -> None:
    """Show the time factors of printers by feature; show nothing if no printer has enough prints."""
    rows = []
    for speed in speeds:
        factors = speed.feature_factors
        if factors is not None:
            values = (factors.walls, factors.infill, factors.skins, factors.supports, factors.travel)
            source = "" if factors.own else " of its family"
            learned_from = f"{format_count(factors.prints, 'print')}{source}"
            rows.append(
                (speed.printer, f"{speed.time_factor:.2f}", *(f"{v:.2f}" for v in values), learned_from)
            )
    if rows:
        screen.print("\nratio of actual to estimated printing time, learned from finished prints:")
        for line in lay_out_table(_SPEED_COLUMNS, rows, read_terminal_width(screen)):
            screen.print(line)


@with_farm
def report(
    paths: FarmPaths,
    job: Job,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="The file to write; default: job-N.html in the current folder."),
    ] = None,
) -> None:
    """Write an HTML page on a job: its figures, a Gantt chart, what failed and why, and its parts."""
    from farm.cli.job_files import fetch_files, is_shown_in_report
    from farm.cli.job_report import find_local_file, render_report  # slow to load

    client, target = connect(paths), out or Path(f"job-{job}.html")
    if paths.url is None:
        page = render_report(client, job, find_local_file)
    else:
        with TemporaryDirectory() as folder:
            result = fetch_files(client, job, Path(folder), select=is_shown_in_report)
            page = render_report(client, job, result.find)
    try:
        target.write_text(page.text, encoding="utf-8")
    except OSError as error:
        cause = error.strerror or error
        raise FarmError(f"{target} cannot be written ({cause}); give another file with --out") from error
    if page.lacks_pictures:
        print_notice(f"no permission to read the files of job {job}: the page has no pictures")
    print(target)


@with_farm
def hosts(
    paths: FarmPaths,
    update: Annotated[
        bool,
        typer.Option(
            "--update",
            help="Replace agents of other versions when they are idle. "
            "Update one host first, and stop if it fails.",
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Show the other computers that run agents, with the connection of each to the daemon; update their
    agents (--update).
    """
    client = connect(paths)
    if update:
        updated_hosts = client.update_hosts()
        if not json:
            print(
                f"updating the agents of {' '.join(updated_hosts.hosts)}, one host first; each agent is "
                "replaced when it is idle"
            )
    response = client.fetch_hosts()
    if json:
        print_json(response)
        return
    if not response.hosts:
        print("no printer has a `host_command` that ends with `farm host`")
        return
    rows = [
        (
            host.host,
            format_time(host.connected, response.now)
            if host.connected
            else f"lost {format_time(host.lost, response.now)}",
            host.version or "",
            str(sum(agent.state == "printing" for agent in host.agents)),
            f"{sum(agent.pid is not None for agent in host.agents)} of {len(host.printers)}",
            str(len(host.ports)),
            host.waiting or "",
        )
        for host in response.hosts
    ]
    screen = open_console()
    for line in lay_out_table(_HOST_COLUMNS, rows, read_terminal_width(screen)):
        screen.print(line)
