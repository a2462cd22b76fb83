"""The morning after a night of five plates on five printers: three done, one failed, one still printing."""

from pathlib import Path

from farm import api
from farm.config import Fleet
from farm.model import AgentSnapshot, Bed, FilamentState, Hold, HoldCode, Link, PrintState
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.books import Books
from farm.views.context import Scene
from farm.views.history import night_view, shown_jobs
from farm.views.jobs import job_view, printer_view
from farm.views.tasks import todo
from make_books import ended, job, plan, run

PRINTERS = [f"um2-{i:02d}" for i in range(1, 6)]
FLEET = Fleet.model_validate(
    {"printers": [{"name": n, "model": "m", "port": f"/dev/{n}", "colour": "white"} for n in PRINTERS]}
)
NOW_S = 7 * 3600.0
HOLD = Hold(code=HoldCode.BED_NOT_CLEAR, text="its bed is not clear")


def night_books():
    books, _ = run(
        Books(),
        *(ev.PrinterAdded(at_s=0.0, name=name, bed=Bed.CLEAR) for name in PRINTERS),
        ev.JobSubmitted(at_s=0.0, job=job()),
        ev.PlanningStarted(at_s=0.0, job=1),
        plan(1, 5),
        *(
            ev.PlateAssigned(at_s=2.0, plate=f"1/0{i}", printer=name, print_id=f"{name} {i}")
            for i, name in enumerate(PRINTERS, 1)
        ),
        *(ended(f"{name} {i}", at_s=104.0) for i, name in enumerate(PRINTERS[:3], 1)),
        ended(
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


def scene_of(books):
    idle = {"link": Link.READY, "filament": FilamentState.PARKED, "nozzle_c": 24.2, "bed_c": 22.0}
    snapshots = {name: AgentSnapshot(printer=name, **idle) for name in PRINTERS}
    return Scene(FLEET, books, snapshots, StateFolder(Path("/state")), NOW_S)


def status_of(books):
    scene = scene_of(books)
    return api.Status(
        daemon=api.DaemonView(pid=1, version="0", since=""),
        todo=todo(scene),
        fleet=api.FleetView(name="farm", timezone="UTC", time_scale=1, now=scene.moment(NOW_S), file="f"),
        printers=[printer_view(scene, FLEET.printer(name), HOLD) for name in PRINTERS],
        jobs=[job_view(scene, one) for one in shown_jobs(books)],
        night=night_view(scene),
    )
