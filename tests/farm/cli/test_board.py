"""The operator's morning: what to do now, the night, the jobs, the printers."""

import io
from pathlib import Path

import pytest
from rich.console import Console

from farm import api
from farm.cli.board import board, names
from farm.config import Fleet
from farm.model import AgentSnapshot, Bed, FilamentState, Link, PrintState, Verdict
from farm.paths import StateFolder
from farm.tracking import events as ev
from farm.tracking.books import Books
from farm.tracking.chronicle import history, night_view, shown_jobs
from farm.tracking.view import Scene, job_view, printer_view, todo
from make_books import ended, job, plan, run

PRINTERS = [f"um2-{i:02d}" for i in range(1, 6)]
FLEET = Fleet.model_validate(
    {"printers": [{"name": n, "model": "m", "port": f"/dev/{n}", "colour": "white"} for n in PRINTERS]}
)
NOW_S = 7 * 3600.0


def assigned(plate, printer, at_s=2.0):
    return ev.PlateAssigned(at_s=at_s, plate=plate, printer=printer, print_id=printer + plate)


def morning():
    """Three plates done, one failed, one still printing."""
    books, _ = run(
        Books(),
        *(ev.PrinterAdded(at_s=0.0, name=name, bed=Bed.CLEAR) for name in PRINTERS),
        ev.JobSubmitted(at_s=0.0, job=job()),
        ev.PlanningStarted(at_s=0.0, job=1),
        plan(1, 5),
        *(assigned(f"1/0{i}", printer) for i, printer in enumerate(PRINTERS, 1)),
        *(ended(f"{printer}1/0{i}", at_s=104.0) for i, printer in enumerate(PRINTERS[:3], 1)),
        ended(
            "um2-041/04", PrintState.FAILED, at_s=47.0, fault="heater_timeout", reason="it does not get warm"
        ),
        ev.PrintProgressed(
            at_s=3.0, print_id="um2-051/05", state=PrintState.PRINTING, started_s=2.0, extruded=True
        ),
    )
    return books


def status(books):
    idle = {"link": Link.READY, "filament": FilamentState.PARKED, "nozzle_c": 24.2, "bed_c": 22.0}
    snapshots = {name: AgentSnapshot(printer=name, **idle) for name in PRINTERS}
    scene = Scene(FLEET, books, snapshots, StateFolder(Path("/state")), NOW_S)
    return api.Status(
        daemon=api.DaemonView(pid=1, version="0", since=""),
        todo=todo(scene),
        fleet=api.FleetView(name="farm", timezone="UTC", time_scale=1, now=scene.moment(NOW_S), file="f"),
        printers=[printer_view(scene, FLEET.printer(name), None) for name in PRINTERS],
        jobs=[job_view(scene, one) for one in shown_jobs(books)],
        night=night_view(scene),
    ), scene


def shown(view, width=120):
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(board(view, width))
    return [line.rstrip() for line in console.export_text().splitlines()]


def test_it_begins_with_what_a_person_has_to_do_now():
    lines = shown(status(morning())[0])
    assert lines[1] == "DO NOW   take off 3: um2-01..03     look at: um2-04 it does not get warm 00:00"
    assert lines[2].startswith("NIGHT    3 of 5 plates printed, 1 failed, 1 still printing; 9 g + 1 g wasted")
    assert lines[3].startswith("JOB 1    bracket.stl: printed 3/5, good 0/3; expected 100 s, now ")
    table = [line.split() for line in lines if line.startswith("um2-")]
    assert table[0][:7] == ["um2-01", "remove", "1/01", "Thu", "00:01", "+2%", "PLA"]
    assert [row[1] for row in table] == ["remove"] * 3 + ["look", "printing"]


def test_what_has_been_looked_at_is_good_or_bad():
    verdicts = zip(PRINTERS[:3], (Verdict.GOOD, Verdict.BAD, Verdict.GOOD), strict=True)
    books, _ = run(
        morning(),
        *(ev.BedCleared(at_s=300.0, printer=n, by="ann", verdict=v, why="warped") for n, v in verdicts),
    )
    view, scene = status(books)
    assert (view.jobs[0].printed, view.jobs[0].good) == (2, 2)
    assert view.jobs[0].wasted_grams == pytest.approx(3.0 + 3.0 * 35 / 90)
    rows = history(scene, job=1)
    assert [(row.printer, row.wasted) for row in rows] == [
        ("um2-04", True),
        *(("um2-01", False), ("um2-02", True), ("um2-03", False)),
    ]
    assert [row.part for row in history(scene, printer="um2-02")] == ["1/p02"]
    assert history(scene, last=1) == rows[-1:]


def test_things_to_do_share_a_line_only_where_it_is_long_enough():
    narrow = shown(status(morning())[0], width=60)
    assert narrow[1:3] == [
        "DO NOW   take off 3: um2-01..03",
        "         look at: um2-04 it does not get warm 00:00",
    ]
    books, _ = run(Books(), *(ev.PrinterAdded(at_s=0.0, name=name, bed=Bed.CLEAR) for name in PRINTERS))
    assert shown(status(books)[0])[1] == "DO NOW   nothing"


@pytest.mark.parametrize(
    ("printers", "text"),
    [
        (["um2-02", "um2-01", "um2-03", "um2x-01"], "um2-01..03 um2x-01"),
        (["a9", "a10", "a12", "b"], "a9..10 a12 b"),
        (["42/01", "42/03"], "42/01 42/03"),
        ([], ""),
    ],
)
def test_names_that_count_on_are_drawn_together(printers, text):
    assert names(printers) == text


def test_jobs_that_are_over_leave_the_board_but_those_to_be_judged_stay():
    books, _ = run(Books(), *(ev.JobSubmitted(at_s=0.0, job=job(i)) for i in range(1, 31)))
    books, _ = run(books, *(ev.JobCancelled(at_s=1.0, job=i) for i in range(2, 31)))
    assert [one.id for one in shown_jobs(books)] == [1, *range(21, 31)]
