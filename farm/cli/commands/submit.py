"""`farm submit` and `farm approve`: submit a model with its print options, and release a held job."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from decompose.options import Engine
from farm import api
from farm.cli.client import Client, connect
from farm.cli.display import (
    ProgressLines,
    follow_job,
    open_console,
    print_json,
    retry_over_restart,
    show_result,
    show_submitted,
    show_timeline,
    show_upload,
)
from farm.cli.notices import print_notice
from farm.cli.options import Job, Json, LongestSide, Quality, Scale, parse_printer_count, with_farm
from farm.errors import ErrorCode, FarmError, Refused
from farm.model import JobOptions, JobState
from farm.paths import Places

_POLL_S = 0.5


@with_farm
def submit(
    places: Places,
    model: Annotated[Path, typer.Argument(help="STL, 3MF, STEP, OBJ, PLY or OFF; or own G-code.")],
    printers: Annotated[str, typer.Option(help="The number of printers to use, or auto.")] = "auto",
    longest_side: LongestSide = None,
    scale: Scale = None,
    engine: Annotated[Engine, typer.Option(help="The algorithm that decomposes it.")] = Engine.BEST,
    material: Annotated[str | None, typer.Option(help="Use only printers with this material.")] = None,
    colour: Annotated[str | None, typer.Option(help="Use only printers with this colour.")] = None,
    quality: Quality = "glue",
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
    options = _check_options(
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
    client = connect(places)
    number = _upload(client, model, options, quiet=json)
    if dry_run:
        _show_dry_run(client, number, json)
    else:
        _show_job(client, number, wait, json)


def _check_options(**values: Any) -> JobOptions:
    """Check the options of a job. Raises FarmError with the option that is wrong."""
    try:
        return JobOptions(**values)
    except ValidationError as error:
        first = error.errors()[0]
        flag = str(first["loc"][0]).removesuffix("_mm").replace("_", "-")
        raise FarmError(f"--{flag} {first['input']}: {first['msg']}", ErrorCode.SETTINGS) from error


def _upload(client: Client, model: Path, options: JobOptions, quiet: bool) -> int:
    """Upload a model and return the number of its job."""
    if not model.is_file():
        problem = "is a folder" if model.is_dir() else "no such file"
        raise FarmError(f"{model}: {problem}; give the file of a model", ErrorCode.MODEL)
    try:
        with show_upload(quiet) as report:
            submitted = client.submit(model, options, report=report)
    except KeyboardInterrupt:
        print_notice(f"{model.name} may have been submitted: check `farm status` before you submit it again")
        raise
    for notice in submitted.notices:
        print_notice(notice)
    return submitted.job


def _show_job(client: Client, number: int, wait: bool, json: bool) -> None:
    """Show a submitted job; with `wait`, follow it to its end."""
    answer = client.job(number)
    if not json:
        show_submitted(answer.job, wait)
    if wait:
        try:
            answer = follow_job(client, number, quiet=json)
        except KeyboardInterrupt:
            print_notice(f"job {number} continues; `farm status {number}` shows its progress")
            raise
    if json:
        print_json(answer)
    elif wait and (answer.job.parts or not answer.job.exit_code):
        show_result(answer.job)
    _exit_as(answer.job)


def _exit_as(job: api.JobView) -> None:
    """End with the exit code of a failed job, and print its reason."""
    if job.exit_code:
        if job.reason:
            print_notice(f"job {job.id}: {job.reason}")
        raise typer.Exit(job.exit_code)


def _show_dry_run(client: Client, number: int, json: bool) -> None:
    """Show the timeline of a planned job, and cancel the job in any case."""
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
        _exit_as(job)
        timeline = client.timeline(number)
    finally:
        if not JobState(client.job(number).job.state).ended:
            client.cancel(number)
    print_json(timeline) if json else show_timeline(timeline)


@with_farm
def approve(
    places: Places,
    job: Job,
    plan: Annotated[str | None, typer.Option(help="Approve only this plan (see `farm status JOB`).")] = None,
) -> None:
    """Release a held job, to print exactly as planned."""
    client = connect(places)
    held = client.job(job).job
    if not held.plates:
        raise Refused(f"job {job} has no plan yet: it is {held.state}")
    timeline = client.timeline(job)
    client.approve(job, api.ApproveRequest(plan=plan or held.plan or ""))
    show_timeline(timeline)
    print(f"job {job} is approved: plan {held.plan or 'without a number'}")
