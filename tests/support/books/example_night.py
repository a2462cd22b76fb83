"""A farm after a night: of five plates on five printers, three are done, one failed, and one still prints."""

from pathlib import Path

from books.make_books import apply_events, make_end_event, make_job, make_plan_event
from farm import api
from farm.config import Fleet
from farm.model import AgentSnapshot, Bed, FilamentState, Hold, HoldCode, Link, PrintState
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.books import Books
from farm.views import (
    ViewContext,
    describe_job,
    describe_night,
    describe_printer,
    list_tasks,
    select_shown_jobs,
)
from farm.wording import group_holds

PRINTERS = [f"um2-{i:02d}" for i in range(1, 6)]
FLEET = Fleet.model_validate(
    {"printers": [{"name": n, "model": "m", "port": f"/dev/{n}", "colour": "white"} for n in PRINTERS]}
)
NOW_S = 7 * 3600.0
HOLD = Hold(code=HoldCode.BED_NOT_CLEAR, text="its bed is not clear")


def make_night_books():
    books, _ = apply_events(
        Books(),
        *(ev.PrinterAdded(at_s=0.0, printer=name, bed=Bed.CLEAR) for name in PRINTERS),
        ev.JobSubmitted(at_s=0.0, job=make_job()),
        ev.PlanningStarted(at_s=0.0, job=1),
        make_plan_event(1, 5),
        *(
            ev.PlateAssigned(at_s=2.0, plate=f"1/0{i}", printer=name, print_id=f"{name} {i}")
            for i, name in enumerate(PRINTERS, 1)
        ),
        *(make_end_event(f"{name} {i}", at_s=104.0) for i, name in enumerate(PRINTERS[:3], 1)),
        make_end_event(
            "um2-04 4",
            PrintState.FAILED,
            47.0,
            fault="heater_timeout",
            reason="it does not get warm",
            printed_share=35 / 90,
        ),
        ev.PrintProgressed(
            at_s=3.0, print_id="um2-05 5", state=PrintState.PRINTING, started_s=2.0, extruded=True
        ),
    )
    return books


def make_view_context(books):
    idle_fields = {"link": Link.READY, "filament": FilamentState.PARKED, "nozzle_c": 24.2, "bed_c": 22.0}
    snapshots = {name: AgentSnapshot(printer=name, **idle_fields) for name in PRINTERS}
    return ViewContext(FLEET, books, snapshots, StateFolder(Path("/state")), NOW_S)


def make_status(books):
    context = make_view_context(books)
    return api.Status(
        daemon=api.DaemonView(pid=1, version="0", since=""),
        todo=list_tasks(context),
        fleet=api.FleetView(
            name="farm", timezone="UTC", time_scale=1, now=context.format_time(NOW_S), file="f"
        ),
        printers=[describe_printer(context, FLEET.find_printer(name), HOLD) for name in PRINTERS],
        jobs=[describe_job(context, item) for item in select_shown_jobs(books)],
        night=describe_night(context),
    )


def summarise_status(status):
    """Return the status without the parts and plates of the jobs, as `farm status` prints it."""
    figures = set(api.JobOverview.model_fields)
    jobs = [
        api.JobSummary(**{name: getattr(job, name) for name in figures}, plate_count=job.plate_count)
        for job in status.jobs
    ]
    waits = [
        api.Wait(hold=hold, plates=[name.replace("/p", "/") for name in names], names=names)
        for hold, names in group_holds(status.jobs)
    ]
    farm_figures = {name: getattr(status, name) for name in api.FarmOverview.model_fields}
    return api.StatusSummary(**farm_figures, jobs=jobs, waits=waits)
