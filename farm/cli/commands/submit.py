"""`farm submit`: a model, and how, when and where to print it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from farm import api
from farm.cli.client.daemon_client import Client
from farm.cli.display import night_timeline, progress, tables
from farm.cli.display.console import console
from farm.cli.display.format import say
from farm.cli.options import Json, placed
from farm.cli.printer_count import count_or_auto
from farm.errors import ErrorCode, FarmError, Refused
from farm.model import Engine, JobOptions, JobState
from farm.paths import Places

_EVERY_S = 0.5


@placed
def submit(
    places: Places,
    model: Annotated[Path, typer.Argument(help="STL, OBJ, PLY or OFF; or G-code, printed as it is.")],
    printers: Annotated[str, typer.Option(help="How many printers it may use, or auto.")] = "auto",
    longest_side: Annotated[float | None, typer.Option(help="Scale it to this longest side, mm.")] = None,
    scale: Annotated[float | None, typer.Option(help="Scale it by this factor (1000: metres).")] = None,
    engine: Annotated[Engine, typer.Option(help="How to decompose it.")] = Engine.BEST,
    material: Annotated[str | None, typer.Option(help="Only printers with this material.")] = None,
    colour: Annotated[str | None, typer.Option(help="Only printers with this colour.")] = None,
    quality: Annotated[str, typer.Option(help="glue, paper, or one of Cura's.")] = "glue",
    priority: Annotated[int, typer.Option(help="Higher goes first.")] = 0,
    at: Annotated[str | None, typer.Option(help="Not before: 22:00, fri 22:00, 2026-11-21T22:00.")] = None,
    overnight: Annotated[bool, typer.Option("--overnight", help="Not before attended hours end.")] = False,
    done_by: Annotated[str | None, typer.Option(help="As few parts as are printed by then.")] = None,
    spares: Annotated[int, typer.Option(help="Free printers kept for what fails while nobody is there.")] = 0,
    hold: Annotated[bool, typer.Option("--hold", help="Plan it; print after `farm approve`.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the plan; print nothing.")] = False,
    wait: Annotated[bool, typer.Option("--wait", help="Return when the last part is printed.")] = False,
    json: Json = False,
) -> None:
    """Print a model on as many printers as make it soonest."""
    if at is not None and overnight:
        raise typer.BadParameter("--at and --overnight exclude each other", param_hint="--overnight")
    try:
        options = JobOptions(
            printers=count_or_auto(printers),
            longest_side_mm=longest_side,
            scale=scale,
            engine=engine,
            material=material,
            colour=colour,
            quality=quality,
            priority=priority,
            at=at,
            overnight=overnight,
            done_by=done_by,
            spares=spares,
            hold=hold or dry_run,
            dry_run=dry_run,
        )
    except ValidationError as error:
        first = error.errors()[0]
        flag = str(first["loc"][0]).removesuffix("_mm").replace("_", "-")
        raise FarmError(f"--{flag} {first['input']}: {first['msg']}", ErrorCode.SETTINGS) from error
    if not model.is_file():
        what = "is a folder" if model.is_dir() else "there is no such file"
        raise FarmError(f"{model}: {what}; name the file of a model", ErrorCode.MODEL)
    client = Client(places.socket)
    try:
        number = client.submit(model, options).job
    except KeyboardInterrupt:
        say(f"{model.name} may be a job all the same: look at `farm status` before it is submitted again")
        raise
    if dry_run:
        _dry_run(client, number, json)
        return
    answer = client.job(number)
    if not json:
        tables.submitted(answer.job, wait)
    if wait:
        try:
            answer = progress.job(client, number, quiet=json)
        except KeyboardInterrupt:
            say(f"job {number} goes on; `farm status {number}` shows how")
            raise
    job = answer.job
    if json:
        print(answer.model_dump_json(by_alias=True, indent=2))
    elif wait and (job.parts or not job.exit_code):
        tables.result(job)
    _end_as(job)


def _end_as(job: api.JobView) -> None:
    """End with the job's exit code and its reason."""
    if job.exit_code:
        if job.reason:
            say(f"job {job.id}: {job.reason}")
        raise typer.Exit(job.exit_code)


def _dry_run(client: Client, number: int, json: bool) -> None:
    """Show a job's plan and its night, and take the job back, whatever becomes of it."""
    lines = progress.Lines(console(stderr=True), quiet=json)
    try:
        while True:
            job = progress.patiently(lambda: client.job(number)).job
            if job.state not in (JobState.QUEUED, JobState.PLANNING):
                break
            lines.tell(job)
            if job.waits_for_person and job.hold is not None:
                raise Refused(f"it cannot be planned now: {job.hold.text}")
            time.sleep(_EVERY_S)
        _end_as(job)
        seen = client.night(number)
    finally:
        if not JobState(client.job(number).job.state).ended:
            client.cancel(number)
    print(seen.model_dump_json(by_alias=True, indent=2)) if json else night_timeline.show(seen)
