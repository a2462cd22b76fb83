"""Jobs that ended long ago, with their files in a store."""

import os

from books.make_books import apply_events, make_fleet_events, make_job, make_plan_event
from farm.model import JobState, Print, PrintState, Verdict
from farm.state.books import Books, put, replace_fields
from farm.state.retention import list_referenced_files

DAY_S = 86400.0
NOW_S = 1000 * DAY_S


def make_old_books(*states_and_ages, shared_numbers=()):
    """Make books with a job for each (state, days since its end); jobs in `shared_numbers` share a model."""
    books = apply_events(Books(), *make_fleet_events())[0]
    for number, (state, age_days) in enumerate(states_and_ages, 1):
        model = "shared.npz" if number in shared_numbers else f"model-{number}.npz"
        plan = make_plan_event(number, plates=2)
        job = make_job(number).model_copy(
            update={
                "state": state,
                "model_file": model,
                "ended_s": NOW_S - age_days * DAY_S if state.ended else None,
                "parts": tuple(part.id for part in plan.parts),
                "plates": tuple(plate.id for plate in plan.plates),
                "picture": f"picture-{number}.png",
                "cuts": {f"{number}/p01": f"cut-{number}.json"},
            }
        )
        files = [
            *(part.model_copy(update={"file": _make_file_name(part.id, "stl")}) for part in plan.parts),
            *(
                plate.model_copy(update={"gcode": _make_file_name(plate.id, "gcode")})
                for plate in plan.plates
            ),
        ]
        books = put(books, job, *files)
    return books


def _make_file_name(entity, suffix):
    return f"{entity.replace('/', '-')}.{suffix}"


def add_good_prints(books):
    """Add a good print of every part of the jobs that are done."""
    for plate in books.plates.values():
        job = books.jobs[plate.job]
        if job.state is not JobState.DONE:
            continue
        attempt = Print(
            id=f"print-{plate.id}", plate=plate.id, job=job.id, printer=plate.printer, number=job.id,
            state=PrintState.DONE, verdict=Verdict.GOOD, assigned_s=job.ended_s - 200.0,
            started_s=job.ended_s - 190.0, ended_s=job.ended_s, extruded=True, grams=3.0,
        )  # fmt: skip
        books = put(books, replace_fields(plate, prints=(attempt.id,)), attempt)
    return books


def write_files(books, state, size=1000, names=None):
    """Write the files with these names, or all that the books refer to, with an old modification time."""
    state.files.mkdir(exist_ok=True)
    for name in list_referenced_files(books) if names is None else names:
        path = state.files / name
        path.write_bytes(b"x" * size)
        os.utime(path, (1000.0, 1000.0))
