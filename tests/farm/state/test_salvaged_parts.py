"""Complete parts of failed prints: confirmed by a person, and not printed again."""

from datetime import UTC

import pytest

from books.make_books import apply_events, make_end_event, make_planned_books
from farm.config import Fleet
from farm.model import Bed, FilamentState, JobState, PrintState, Reel, Verdict
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.plate_state import MAX_ATTEMPTS, PlateState
from farm.state.salvaged_parts import find_possibly_complete_print, list_reprinting_printers
from farm.views import ViewContext, list_tasks

AGENT_DEATH = {"fault": "agent_died", "reason": "the agent's process ended in the middle of the print"}


def make_assigned_event(plate, printer, print_id, at_s=2.0):
    return ev.PlateAssigned(at_s=at_s, plate=plate, printer=printer, print_id=print_id)


def make_dead_agent_books(plates=1, at_s=110.0, **fields):
    """Make books with a plate of 90 s on `a`, whose agent was found dead at this time."""
    first_events = (
        make_assigned_event("1/01", "a", "x"),
        make_end_event("x", PrintState.FAILED, at_s, **{**AGENT_DEATH, **fields}),
    )
    return apply_events(make_planned_books(plates), *first_events)[0]


def make_complete_part_event(print_id="x", printer="a"):
    return ev.BedCleared(at_s=500.0, printer=printer, by="ann", whole=print_id)


def list_look_tasks(books):
    sections = [{"name": n, "model": "ultimaker2_plus", "port": "sim://ultimaker2_plus"} for n in "abc"]
    fleet = Fleet.model_validate({"fleet": {"timezone": "UTC"}, "printers": sections})
    assert fleet.zone.utcoffset(None) == UTC.utcoffset(None)
    context = ViewContext(fleet, books, {}, StateFolder("/state"), 500.0, is_startup_over=False)
    return [item for item in list_tasks(context) if item.code in ("look", "outage")]


def test_complete_part_is_good_and_not_reprinted():
    books = make_dead_agent_books()
    assert books.find_plate_state(books.plates["1/01"]) is PlateState.WAITING
    books, instructions = apply_events(books, make_complete_part_event())
    assert books.find_plate_state(books.plates["1/01"]) is PlateState.GOOD
    assert books.jobs[1].state is JobState.DONE
    assert list(books.list_waiting_plates()) == []
    salvaged_print = books.prints["x"]
    assert (salvaged_print.state, salvaged_print.verdict) == (PrintState.DONE, Verdict.GOOD)
    assert (
        "confirmed good by ann" in salvaged_print.verdict_why
        and AGENT_DEATH["reason"] in salvaged_print.verdict_why
    )
    printer = books.get_printer("a")
    assert (printer.bed, printer.attention_reason) == (Bed.CLEAR, None)
    assert instructions == [ev.SendCleared(printer="a", filament=None)]


def test_failed_job_is_done_if_its_last_part_is_complete():
    books = make_planned_books(plates=1)
    for attempt in range(MAX_ATTEMPTS):
        name = f"x{attempt}"
        cleared_event = ev.BedCleared(at_s=1.0, printer="a", by="ann")
        failed_event = make_end_event(name, PrintState.FAILED, 110.0, **AGENT_DEATH)
        books, _ = apply_events(books, cleared_event, make_assigned_event("1/01", "a", name), failed_event)
    assert books.jobs[1].state is JobState.FAILED
    books, _ = apply_events(books, make_complete_part_event(f"x{MAX_ATTEMPTS - 1}"))
    assert (books.jobs[1].state, books.jobs[1].error) == (JobState.DONE, None)


def test_salvaged_part_uses_its_full_filament():
    reel = Reel(material="generic_pla", grams=100.0, nozzle_mm=0.4)
    books, _ = apply_events(make_planned_books(1), ev.ReelLoaded(at_s=1.0, printer="a", reel=reel, by="ann"))
    failed_event = make_end_event("x", PrintState.FAILED, 110.0, printed_share=0.5, **AGENT_DEATH)
    books, _ = apply_events(books, make_assigned_event("1/01", "a", "x"), failed_event)
    assert books.get_printer("a").reel.grams == pytest.approx(98.5)
    books, _ = apply_events(books, make_complete_part_event())
    assert books.get_printer("a").reel.grams == pytest.approx(97.0)
    assert books.prints["x"].grams == pytest.approx(3.0)


def test_reprint_that_has_not_started_is_cancelled():
    books, _ = apply_events(make_dead_agent_books(), make_assigned_event("1/01", "b", "y", 120.0))
    books, instructions = apply_events(books, make_complete_part_event())
    assert [type(event) for event in instructions] == [ev.SendCancel, ev.SendCleared]
    assert (instructions[0].print_id, instructions[0].printer) == ("y", "b")
    assert list_reprinting_printers(books, books.prints["x"]) == []
    books, _ = apply_events(
        books, make_end_event("y", PrintState.CANCELLED, 130.0, started_s=None, extruded=False)
    )
    assert books.jobs[1].state is JobState.DONE and books.get_printer("b").bed is Bed.CLEAR


def test_started_reprint_continues_until_a_person_ends_it():
    started_event = ev.PrintProgressed(
        at_s=130.0, print_id="y", state=PrintState.PRINTING, started_s=125.0, extruded=True
    )
    books, _ = apply_events(
        make_dead_agent_books(), make_assigned_event("1/01", "b", "y", 120.0), started_event
    )
    books, instructions = apply_events(books, make_complete_part_event())
    assert [type(event) for event in instructions] == [ev.SendCleared]
    assert list_reprinting_printers(books, books.prints["x"]) == ["b"]
    stopped_books, instructions = apply_events(books, ev.PlateCancelled(at_s=510.0, plate="1/01", by="ann"))
    assert [(type(event), event.print_id) for event in instructions] == [(ev.SendCancel, "y")]
    assert list_reprinting_printers(stopped_books, stopped_books.prints["x"]) == []
    assert not stopped_books.plates["1/01"].cancelled
    for state in (PrintState.DONE, PrintState.FAILED):
        new_books, _ = apply_events(books, make_end_event("y", state, 600.0))
        assert new_books.jobs[1].state is JobState.DONE
        assert new_books.find_plate_state(new_books.plates["1/01"]) is PlateState.GOOD


def test_complete_part_makes_the_pieces_of_its_recut_unnecessary():
    books = make_dead_agent_books()
    old_plate = books.plates["1/01"]
    parts = [books.parts["1/p01"].model_copy(update={"id": f"1/p01{x}", "plate": f"1/01{x}"}) for x in "ab"]
    plates = [old_plate.model_copy(update={"id": f"1/01{x}", "parts": (f"1/p01{x}",)}) for x in "ab"]
    replaced_event = ev.PlateReplaced(at_s=115.0, plate="1/01", parts=tuple(parts), plates=tuple(plates))
    books, _ = apply_events(books, replaced_event, make_assigned_event("1/01a", "b", "y", 120.0))
    assert find_possibly_complete_print(books, "a").id == "x"
    books, instructions = apply_events(books, make_complete_part_event())
    assert books.jobs[1].state is JobState.DONE
    assert instructions[0].print_id == "y"


def test_task_asks_for_the_verdict_with_part_and_command():
    (item,) = list_look_tasks(make_dead_agent_books())
    assert item.printers == ["a"]
    for text in (item.text, item.brief):
        assert text.endswith("; if part 1/p01 is good nevertheless: `farm cleared a --good 1/p01`")
    assert "then `farm cleared a`" in item.text


def test_task_asks_for_the_verdict_after_an_outage():
    first_events = (make_assigned_event("1/01", "a", "x"), make_assigned_event("1/02", "b", "y"))
    lost_events = (make_end_event(name, PrintState.FAILED, 110.0, **AGENT_DEATH) for name in "xy")
    (item,) = list_look_tasks(apply_events(make_planned_books(2), *first_events, *lost_events)[0])
    assert item.code == "outage"
    assert "`farm cleared a --good 1/p01`" in item.text and "`farm cleared b --good 1/p02`" in item.text


@pytest.mark.parametrize(
    "fields",
    [
        {"at_s": 60.0},  # long before the expected end of its plate
        {"extruded": False},
        {"started_s": None},
        {"later_events": (make_complete_part_event(),)},
        {"later_events": (ev.BedCleared(at_s=500.0, printer="a", by="ann"),)},
        {"later_events": (ev.PlateCancelled(at_s=500.0, plate="1/01", by="ann"),)},
        # The reprint ended meanwhile.
        {"later_events": (make_assigned_event("1/01", "b", "y"), make_end_event("y", at_s=300.0))},
    ],
)
def test_no_verdict_is_requested_for_an_incomplete_part(fields):
    later_events = fields.pop("later_events", ())
    books, _ = apply_events(make_dead_agent_books(**fields), *later_events)
    assert find_possibly_complete_print(books, "a") is None


def test_print_ended_by_a_person_is_not_salvageable():
    requested_event = ev.PrintFailRequested(at_s=100.0, print_id="x", why="a blob", by="ann")
    ended_event = make_end_event("x", PrintState.CANCELLED, 110.0, filament=FilamentState.PARKED)
    books, _ = apply_events(
        make_planned_books(1), make_assigned_event("1/01", "a", "x"), requested_event, ended_event
    )
    assert books.prints["x"].state is PrintState.FAILED
    assert find_possibly_complete_print(books, "a") is None
