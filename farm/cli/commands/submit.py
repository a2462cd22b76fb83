"""`farm submit` and `farm approve`: submit a model with its print options, and release a held job."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from decompose.options import Engine
from farm import api
from farm.cli.client import connect
from farm.cli.display import show_timeline
from farm.cli.options import (
    Job,
    Json,
    LongestSide,
    Marks,
    PinFit,
    Pins,
    Quality,
    Scale,
    parse_pins,
    parse_printer_count,
    with_farm,
)
from farm.cli.submission import Submitter, expand_patterns
from farm.errors import ErrorCode, FarmError, RefusedError
from farm.model import JobOptions
from farm.paths import FarmPaths


@with_farm
def submit(
    paths: FarmPaths,
    models: Annotated[
        list[Path],
        typer.Argument(
            metavar="MODEL...",
            help="STL, 3MF, STEP, OBJ, PLY or OFF; or your own G-code. Each file is a job.",
        ),
    ],
    printers: Annotated[str, typer.Option(help="The number of printers to use, or auto.")] = "auto",
    longest_side: LongestSide = None,
    scale: Scale = None,
    engine: Annotated[Engine, typer.Option(help="The algorithm that decomposes the model.")] = Engine.BEST,
    material: Annotated[
        str | None,
        typer.Option(help="Use only printers with this material, like PLA or 'black PLA'."),
    ] = None,
    colour: Annotated[str | None, typer.Option(help="Use only printers with this colour.")] = None,
    quality: Quality = "glue",
    pins: Pins = "none",
    pin_fit: PinFit = None,
    marks: Marks = False,
    priority: Annotated[int, typer.Option(help="Jobs of higher priority print first.")] = 0,
    at: Annotated[
        str | None, typer.Option(help="Start at this time: 22:00, fri 22:00, 2026-11-21T22:00.")
    ] = None,
    overnight: Annotated[
        bool, typer.Option("--overnight", help="Start when the attended hours end.")
    ] = False,
    done_by: Annotated[
        str | None, typer.Option(help="Use as few parts as can be printed by this time.")
    ] = None,
    assembled_by: Annotated[
        str | None, typer.Option(help="Use as few parts as can be printed and glued by this time.")
    ] = None,
    spares: Annotated[
        int, typer.Option(help="Idle printers to keep in reserve for failed parts overnight.")
    ] = 0,
    copies: Annotated[int, typer.Option(help="Print the model this many times.")] = 1,
    name: Annotated[str | None, typer.Option(help="Name of the job, instead of the file's.")] = None,
    note: Annotated[str | None, typer.Option(help="A note, shown with the job.")] = None,
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
    models = expand_patterns(models)
    if name is not None and len(models) > 1:
        raise typer.BadParameter(
            "is for one model: leave it out, or submit the models one by one", param_hint="--name"
        )
    options = _check_options(
        printers=parse_printer_count(printers),
        longest_side_mm=longest_side,
        scale=scale,
        engine=engine,
        material=material,
        colour=colour,
        quality=quality,
        pin_mm=parse_pins(pins),
        pin_fit_mm=pin_fit,
        marks=marks,
        priority=priority,
        at=at,
        overnight=overnight,
        done_by=done_by,
        assembled_by=assembled_by,
        spares=spares,
        copies=copies,
        name=name,
        note=note,
        hold=hold or dry_run,
        dry_run=dry_run,
    )
    submitter = Submitter(connect(paths), options, wait, quiet=json)
    code = submitter.submit_model(models[0]) if len(models) == 1 else submitter.submit_models(models)
    if code:
        raise typer.Exit(code)


def _check_options(**values: Any) -> JobOptions:
    """Check the options of a job. Raises FarmError with the invalid option."""
    try:
        return JobOptions(**values)
    except ValidationError as error:
        first = error.errors()[0]
        flag = str(first["loc"][0]).removesuffix("_mm").replace("_", "-")
        raise FarmError(f"--{flag} {first['input']}: {first['msg']}", ErrorCode.SETTINGS) from error


@with_farm
def approve(
    paths: FarmPaths,
    job: Job,
    plan: Annotated[str | None, typer.Option(help="Approve only this plan (see `farm status JOB`).")] = None,
) -> None:
    """Release a held job, which is then printed exactly as planned."""
    client = connect(paths)
    job_view = client.fetch_job(job).job
    if not job_view.plates:
        raise RefusedError(f"job {job} has no plan yet: it is {job_view.state}")
    timeline = client.fetch_timeline(job)
    client.approve_job(job, api.ApproveRequest(plan=plan or job_view.plan or ""))
    show_timeline(timeline)
    print(f"job {job} is approved: plan {job_view.plan or 'without a number'}")
