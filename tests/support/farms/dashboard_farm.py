"""Books and views of a farm for tests of the dashboard, without processes."""

from pathlib import Path

from books.make_books import apply_events, make_end_event, make_job, make_plan_event
from books.scheduling_examples import make_printer, make_rules
from farm.config import Fleet
from farm.model import Verdict
from farm.paths import StateFolder
from farm.scheduling import PlateQueue, Situation, describe_plates
from farm.state import events as ev
from farm.state.books import Books
from farm.views import ViewContext

DAY_S = 86400.0
START_S = 1_700_000_000.0  # Tue 14 Nov 2023 22:13:20 UTC


def make_fleet(names="abc", **options):
    """Make a fleet of simulated printers."""
    rows = [{"name": n, "model": "ultimaker2_plus", "port": "sim://ultimaker2_plus"} for n in names]
    return Fleet.model_validate({"fleet": {"name": "lab", **options}, "printers": rows})


def add_planned_job(books, number, plates=2, at_s=START_S, is_held=False, **changes):
    """Return the books with another planned job, which waits for an approval if it is held."""
    job = make_job(number).model_copy(update={"submitted_s": at_s, **changes})
    return apply_events(
        books,
        ev.JobSubmitted(at_s=at_s, job=job),
        ev.PlanningStarted(at_s=at_s, job=number),
        make_plan_event(number, plates, at_s).model_copy(update={"held": is_held}),
    )[0]


def add_print(books, plate, printer_name, begin_s, duration_s, **changes):
    """Return the books with an ended print of a plate, whose bed is cleared."""
    name = f"{plate}-{begin_s}"
    books, _ = apply_events(
        books,
        ev.PlateAssigned(at_s=begin_s, plate=plate, printer=printer_name, print_id=name),
        make_end_event(name, at_s=begin_s + duration_s, started_s=begin_s, **changes),
    )
    return books


def judge_print(books, printer_name, at_s, verdict=Verdict.GOOD, reason=None):
    """Return the books with a cleared bed and a verdict on its part."""
    cleared_event = ev.BedCleared(
        at_s=at_s, printer=printer_name, by="ann", filament=None, verdict=verdict, why=reason
    )
    return apply_events(books, cleared_event)[0]


def make_empty_books(names="abc"):
    """Make books with idle printers."""
    return apply_events(Books(), *(ev.PrinterAdded(at_s=START_S, printer=n, bed="clear") for n in names))[0]


def make_context(books, now_s, fleet=None, **changes):
    """Make the context from which views are computed."""
    return ViewContext(fleet or make_fleet(), books, {}, StateFolder(Path("/state")), now_s, **changes)


def make_situation(books, now_s, names="abc", attended=(), quiet=()):
    """Make a situation with all waiting plates of the books."""
    plates = PlateQueue.from_plates(describe_plates(books.list_waiting_plates(), books))
    fleet = tuple(make_printer(n, is_booked=books.find_open_print(n) is not None) for n in names)
    return Situation(plates, fleet, make_rules(attended, quiet), now_s)
