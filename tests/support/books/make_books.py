"""Events and books for tests."""

import itertools

from farm.model import Bed, FilamentState, Job, JobOptions, Key, Part, PartGeometry, Plate, PrintState, Role
from farm.state import events as ev
from farm.state.books import Books
from farm.state.transitions import apply, list_undeclared_changes
from farm.state.validation import validate_books

PRINTERS = ("a", "b", "c")


def make_job(number=1):
    return Job(
        id=number,
        request_id=f"request-{number}",
        name="bracket.stl",
        model_file="m.npz",
        options=JobOptions(),
        submitted_s=0.0,
    )


def make_key(name="slicer", role=Role.PRINT, **fields):
    values = {"id": "abcd2345", "digest": "0" * 64, "created_s": 0.0, "by": "ann"}
    return Key(name=name, role=role, **{**values, **fields})


def make_plan_event(number=1, plates=2, at_s=1.0):
    names = [f"{number}/{i:02d}" for i in range(1, plates + 1)]
    return ev.JobPlanned(
        at_s=at_s,
        job=number,
        parts=tuple(
            Part(
                id=f"{number}/p{i:02d}",
                job=number,
                plate=name,
                file="p.stl",
                geometry=PartGeometry(
                    to_model=(1.0,) * 16, min_mm=(0.0, 0.0, 0.0), max_mm=(1.0, 1.0, 1.0), volume_mm3=1.0
                ),
            )
            for i, name in enumerate(names, 1)
        ),
        plates=tuple(
            Plate(
                id=name,
                job=number,
                parts=(f"{number}/p{i:02d}",),
                gcode="g.gcode",
                sha256="0" * 64,
                sliced_s=90.0,
                expected_s=100.0,
                grams=3.0,
                filament_mm=400.0,
                layers=10,
                min_mm=(-10.0, -10.0, 0.2),
                max_mm=(10.0, 10.0, 20.0),
                material="generic_pla",
                nozzle_mm=0.4,
                printer=printer,
            )
            for i, (name, printer) in enumerate(zip(names, itertools.cycle(PRINTERS), strict=False), 1)
        ),
        repairs=(),
        scale=1.0,
        serial_s=500.0,
        expected_s=100.0,
        picture=None,
    )


def apply_events(books, *events):
    instructions = []
    for event in events:
        old_books = books
        books, more_instructions = apply(event, old_books)
        assert list_undeclared_changes(event, old_books, books) == []
        assert validate_books(books) == []
        instructions += more_instructions
    return books, instructions


def make_fleet_events(bed=Bed.CLEAR):
    return [ev.PrinterAdded(at_s=0.0, printer=name, bed=bed) for name in PRINTERS]


def make_planned_books(plates=2):
    """Make books with one planned job."""
    events = (
        *make_fleet_events(),
        ev.JobSubmitted(at_s=0.0, job=make_job()),
        ev.PlanningStarted(at_s=0.0, job=1),
        make_plan_event(plates=plates),
    )
    return apply_events(Books(), *events)[0]


def make_end_event(print_id, state=PrintState.DONE, at_s=200.0, extruded=True, **changes):
    facts = {"fault": None, "reason": None, "started_s": 2.0, "filament": FilamentState.PARKED}
    return ev.PrintEnded(
        at_s=at_s, print_id=print_id, state=state, ended_s=at_s, extruded=extruded, **{**facts, **changes}
    )
