"""`farm queue`: the order in which jobs get printers."""

from __future__ import annotations

from typing import Annotated

import typer

from farm import api
from farm.cli import completion
from farm.cli.client import connect
from farm.cli.display import open_console, print_json, read_terminal_width
from farm.cli.display.table import Column, lay_out_table
from farm.cli.options import Json, with_farm
from farm.paths import FarmPaths
from farm.wording import format_time

_COLUMNS = (
    Column("PLACE"),
    Column("JOB"),
    Column("MODEL", rank=1, min_width=12),
    Column("STATE"),
    Column("WAITING", rank=3),
    Column("ENDS"),
    Column("BY", rank=2),
)


@with_farm
def queue(
    paths: FarmPaths,
    job: Annotated[
        int | None,
        typer.Argument(help="The job to move; default: only show the queue.", autocompletion=completion.jobs),
    ] = None,
    to: Annotated[api.QueuePlace | None, typer.Argument(help="One of up, down, first and last.")] = None,
    before: Annotated[
        int | None, typer.Option(help="Move it before this job.", autocompletion=completion.jobs)
    ] = None,
    at: Annotated[
        str | None, typer.Option(help="Start no further plates of the job before this time; `now`: no limit.")
    ] = None,
    json: Json = False,
) -> None:
    """Show the jobs in the order in which they get printers; move one, or change its start time."""
    if job is not None and [to, before, at].count(None) != 2:
        raise typer.BadParameter(
            "give up, down, first or last, or --before JOB, or --at TIME", param_hint="TO"
        )
    if job is None and (before is not None or at is not None):
        raise typer.BadParameter("give a job as well", param_hint="--before" if at is None else "--at")
    client = connect(paths)
    if job is not None and at is not None:
        client.reschedule_job(job, api.JobStart(at=at))
    elif job is not None:
        client.move_job(job, api.QueueMove(to=to, before=before))
    response = client.fetch_queue()
    if json:
        print_json(response)
        return
    if not response.jobs:
        print("no job is waiting")
        return
    rows = [
        (
            str(place),
            str(entry.id),
            entry.name,
            str(entry.state),
            str(entry.waiting or ""),
            format_time(entry.eta, response.now),
            entry.submitted_by or "",
        )
        for place, entry in enumerate(response.jobs, 1)
    ]
    screen = open_console()
    for line in lay_out_table(_COLUMNS, rows, read_terminal_width(screen)):
        screen.print(line)
