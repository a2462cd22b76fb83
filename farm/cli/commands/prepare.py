"""What is settled before a night: `farm load` (reels) and `farm approve` (plans)."""

from __future__ import annotations

from typing import Annotated

import typer

from farm.api import ApproveRequest, LoadRequest
from farm.cli.client.daemon_client import Client
from farm.cli.display import night_timeline
from farm.cli.options import Job, Printer, placed
from farm.errors import Refused
from farm.paths import Places


@placed
def load(
    places: Places,
    printer: Printer,
    material: Annotated[str | None, typer.Option(help="The new reel's, by Cura's name.")] = None,
    colour: Annotated[str | None, typer.Option(help="The new reel's.")] = None,
    grams: Annotated[float | None, typer.Option(help="What is on it.", min=0)] = None,
    nozzle: Annotated[float | None, typer.Option(help="The nozzle that is on now, mm.", min=0.1)] = None,
) -> None:
    """Say what is on a printer: each print takes its grams off, and none starts on too little."""
    if material is None and colour is None and grams is None and nozzle is None:
        raise typer.BadParameter("say what is on it: --material, --colour, --grams, --nozzle")
    request = LoadRequest(material=material, colour=colour, grams=grams, nozzle_mm=nozzle)
    reel = Client(places.socket).load(printer, request)
    amount = f", {reel.grams:.0f} g" if reel.grams is not None else ", grams not known"
    colours = f" {reel.colour}" if reel.colour else ""
    print(f"{printer}: {reel.material}{colours}{amount}, nozzle {reel.nozzle_mm:g} mm")


@placed
def approve(
    places: Places,
    job: Job,
    plan: Annotated[str | None, typer.Option(help="Only if this is its plan (`farm status JOB`).")] = None,
) -> None:
    """Let a held job print exactly as it was planned."""
    client = Client(places.socket)
    held = client.job(job).job
    if not held.plates:
        raise Refused(f"job {job} has no plan yet: it is {held.state}")
    seen = client.night(job)
    client.approve(job, ApproveRequest(plan=plan or held.plan or ""))
    night_timeline.show(seen)
    print(f"job {job} is approved: plan {held.plan or 'of an older farm'}")
