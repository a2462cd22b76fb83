"""Preparations for a print: `farm load` (filament) and `farm approve` (plans)."""

from __future__ import annotations

from typing import Annotated

import typer

from farm.api import ApproveRequest, LoadRequest
from farm.cli.client.daemon_client import Client
from farm.cli.display.timeline import show_timeline
from farm.cli.options import Job, Printer, placed
from farm.errors import Refused
from farm.paths import Places


@placed
def load(
    places: Places,
    printer: Printer,
    material: Annotated[str | None, typer.Option(help="Material of the new reel, by Cura's name.")] = None,
    colour: Annotated[str | None, typer.Option(help="Colour of the new reel.")] = None,
    grams: Annotated[float | None, typer.Option(help="Filament on the new reel, g.", min=0)] = None,
    nozzle: Annotated[float | None, typer.Option(help="Size of the mounted nozzle, mm.", min=0.1)] = None,
) -> None:
    """Record a new reel or nozzle. Prints are deducted from the reel; none starts with too little left."""
    if material is None and colour is None and grams is None and nozzle is None:
        raise typer.BadParameter("give at least one of --material, --colour, --grams and --nozzle")
    request = LoadRequest(material=material, colour=colour, grams=grams, nozzle_mm=nozzle)
    reel = Client(places.socket).load(printer, request)
    amount = f", {reel.grams:.0f} g" if reel.grams is not None else ", amount not known"
    colours = f" {reel.colour}" if reel.colour else ""
    print(f"{printer}: {reel.material}{colours}{amount}, nozzle {reel.nozzle_mm:g} mm")


@placed
def approve(
    places: Places,
    job: Job,
    plan: Annotated[str | None, typer.Option(help="Approve only this plan (see `farm status JOB`).")] = None,
) -> None:
    """Release a held job, to print exactly as planned."""
    client = Client(places.socket)
    held = client.job(job).job
    if not held.plates:
        raise Refused(f"job {job} has no plan yet: it is {held.state}")
    timeline = client.timeline(job)
    client.approve(job, ApproveRequest(plan=plan or held.plan or ""))
    show_timeline(timeline)
    print(f"job {job} is approved: plan {held.plan or 'without a number'}")
