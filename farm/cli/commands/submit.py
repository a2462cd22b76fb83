"""`farm submit`: a model, and how, when and on which printers to print it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from farm import api
from farm.cli.client.daemon_client import Client
from farm.cli.display.console import open_console, print_json, print_notice
from farm.cli.display.job_page import show_result, show_submitted
from farm.cli.display.progress import ProgressLines, follow_job, retry_over_restart
from farm.cli.display.timeline import show_timeline
from farm.cli.options import Json, parse_printer_count, placed
from farm.errors import ErrorCode, FarmError, Refused
from farm.model import Engine, JobOptions, JobState
from farm.paths import Places

_POLL_S = 0.5


@placed
def submit(
    places: Places,
    model: Annotated[Path, typer.Argument(help="STL, OBJ, PLY or OFF; or G-code, printed unchanged.")],
    printers: Annotated[str, typer.Option(help="The number of printers to use, or auto.")] = "auto",
    longest_side: Annotated[
        float | None, typer.Option(help="Scale the model to this longest side, mm.")
    ] = None,
    scale: Annotated[
        float | None, typer.Option(help="Scale the model by this factor (1000: metres).")
    ] = None,
    engine: Annotated[Engine, typer.Option(help="The algorithm that decomposes it.")] = Engine.BEST,
    material: Annotated[str | None, typer.Option(help="Use only printers with this material.")] = None,
    colour: Annotated[str | None, typer.Option(help="Use only printers with this colour.")] = None,
    quality: Annotated[str, typer.Option(help="glue, paper, or a quality of Cura's.")] = "glue",
    priority: Annotated[int, typer.Option(help="Jobs of higher priority print first.")] = 0,
    at: Annotated[
        str | None, typer.Option(help="Start at this time: 22:00, fri 22:00, 2026-11-21T22:00.")
    ] = None,
    overnight: Annotated[
        bool, typer.Option("--overnight", help="Start when the attended hours end.")
    ] = False,
    done_by: Annotated[
        str | None, typer.Option(help="Use the fewest parts that finish by this time.")
    ] = None,
    spares: Annotated[
        int, typer.Option(help="Idle printers to keep in reserve for failed parts overnight.")
    ] = 0,
    hold: Annotated[
        bool, typer.Option("--hold", help="Plan it, but print only after `farm approve`.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the plan and print nothing.")] = False,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until the last part is printed.")] = False,
    json: Json = False,
) -> None:
    """Decompose a model for the free printers, slice the parts and print them."""
    if at is not None and overnight:
        raise typer.BadParameter("--at and --overnight exclude each other", param_hint="--overnight")
    try:
        options = JobOptions(
            printers=parse_printer_count(printers),
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
        what = "is a folder" if model.is_dir() else "no such file"
        raise FarmError(f"{model}: {what}; give the file of a model", ErrorCode.MODEL)
    client = Client(places.socket)
    try:
        number = client.submit(model, options).job
    except KeyboardInterrupt:
        print_notice(
            f"{model.name} may have been submitted: look at `farm status` before you submit it again"
        )
        raise
    if dry_run:
        _dry_run(client, number, json)
        return
    answer = client.job(number)
    if not json:
        show_submitted(answer.job, wait)
    if wait:
        try:
            answer = follow_job(client, number, quiet=json)
        except KeyboardInterrupt:
            print_notice(f"job {number} goes on; `farm status {number}` shows its progress")
            raise
    job = answer.job
    if json:
        print_json(answer)
    elif wait and (job.parts or not job.exit_code):
        show_result(job)
    _end_as(job)


def _end_as(job: api.JobView) -> None:
    """End with the job's exit code and its reason."""
    if job.exit_code:
        if job.reason:
            print_notice(f"job {job.id}: {job.reason}")
        raise typer.Exit(job.exit_code)


def _dry_run(client: Client, number: int, json: bool) -> None:
    """Show the plan and the timeline of a job, and cancel it in any case."""
    lines = ProgressLines(open_console(stderr=True), quiet=json)
    try:
        while True:
            job = retry_over_restart(lambda: client.job(number)).job
            if job.state not in (JobState.QUEUED, JobState.PLANNING):
                break
            lines.update(job)
            if job.waits_for_person and job.hold is not None:
                raise Refused(f"it cannot be planned now: {job.hold.text}")
            time.sleep(_POLL_S)
        _end_as(job)
        timeline = client.timeline(number)
    finally:
        if not JobState(client.job(number).job.state).ended:
            client.cancel(number)
    print_json(timeline) if json else show_timeline(timeline)
