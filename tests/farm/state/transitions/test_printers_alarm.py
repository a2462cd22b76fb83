"""Alarm of a heater that cannot be switched off: task and notices."""

from pathlib import Path

import pytest

from books.make_books import apply_events, make_planned_books
from farm.config import Fleet
from farm.model import AgentPrint, AgentSnapshot, Link, PrintState
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.reconciliation import detect_alarm
from farm.views import ViewContext, describe_printer, list_due_notices, list_tasks

FINDING = "the nozzle went up to 257 C, above 210"
CUT_TEXT = f"{FINDING}; power_off_cmd cut its mains"
FLEET = Fleet.model_validate(
    {"printers": [{"name": name, "model": "m", "port": f"/dev/{name}"} for name in "abc"]}
)


def make_snapshot(alarm: str | None = FINDING, **fields: object) -> AgentSnapshot:
    """Build a snapshot of the agent of `a` while its print ends."""
    agent_print = AgentPrint(
        print_id="x", state=PrintState.ENDING, fault=None, reason=None, progress_s=1.0, print_time_s=9.0,
        extruded=True, started_s=2.0, ended_s=None,
    )  # fmt: skip
    default_fields = {
        "printer": "a", "link": Link.BUSY, "agent_pid": 7, "nozzle_c": 271.4, "bed_c": 60.2,
        "nozzle_target_c": 0.0, "bed_target_c": 0.0, "alarm": alarm, "print": agent_print,
    }  # fmt: skip
    return AgentSnapshot.model_validate(default_fields | fields)


def make_started_books():
    assigned_event = ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
    progress_event = ev.PrintProgressed(
        at_s=3.0, print_id="x", state=PrintState.ENDING, started_s=2.0, extruded=True
    )
    return apply_events(make_planned_books(), assigned_event, progress_event)[0]


def make_context(books, snapshot):
    return ViewContext(FLEET, books, {"a": snapshot}, StateFolder(Path("/state")), now_s=60.0)


def apply_report(books, snapshot, at_s=50.0):
    return apply_events(books, *detect_alarm(books.printers["a"], snapshot, at_s))[0]


def test_alarm_is_the_first_task_with_state_and_temperatures():
    books = apply_report(make_started_books(), make_snapshot())
    first_task = list_tasks(make_context(books, make_snapshot()))[0]
    assert (first_task.code, first_task.printers) == ("alarm", ["a"])
    assert first_task.text == f"go to a now: {FINDING} (ending, nozzle 271 C, target 0, bed 60 C, target 0)"
    assert [task.printers for task in list_tasks(make_context(books, make_snapshot()))].count(["a"]) == 1
    printer_view = describe_printer(make_context(books, make_snapshot()), FLEET.printers[0], None)
    assert (printer_view.state, printer_view.look) == ("look", FINDING)
    idle_snapshot = make_snapshot(link=Link.FAULT, print=None, reason=f"{FINDING}: switch it off")
    assert "(fault, nozzle 271 C" in list_tasks(make_context(make_planned_books(), idle_snapshot))[0].text


@pytest.mark.parametrize("other_state", ["maintenance", "outage"])
def test_alarm_precedes_other_states_of_the_printer(other_state: str):
    books = apply_report(make_started_books(), make_snapshot())
    if other_state == "maintenance":
        books, _ = apply_events(
            books, ev.MaintenanceStarted(at_s=51.0, printer="a", why="a nozzle", by="ann")
        )
    else:
        lost_events = [ev.PrinterLost(at_s=51.0, printer=name) for name in "bc"]
        books, _ = apply_events(books, *lost_events)
        assert books.outage is not None
    assert list_tasks(make_context(books, make_snapshot()))[0].code == "alarm"


def test_alarm_is_notified_once_and_its_outcome_later():
    books = apply_report(make_started_books(), make_snapshot())
    notices = list_due_notices(books, 50.0, 0.0, ())
    assert [notice.text for notice in notices] == [f"go to a now: {FINDING}"]
    books = apply_report(books, make_snapshot(), 51.0)
    assert list_due_notices(books, 51.0, 0.0, {notice.key for notice in notices}) == []
    books = apply_report(books, make_snapshot(CUT_TEXT), 52.0)
    assert [n.text for n in list_due_notices(books, 52.0, 0.0, {n.key for n in notices})] == [
        f"go to a now: {CUT_TEXT}"
    ]


def test_new_alarm_after_a_cleared_one_is_notified():
    books = apply_report(make_started_books(), make_snapshot())
    failed_event = ev.PrintEnded(
        at_s=60.0, print_id="x", state=PrintState.FAILED, fault="heater_stuck_on", reason=CUT_TEXT,
        started_s=2.0, ended_s=60.0, extruded=True, filament="unknown",
    )  # fmt: skip
    books, _ = apply_events(books, failed_event)
    assert books.printers["a"].attention_reason == CUT_TEXT
    books, _ = apply_events(books, ev.BedCleared(at_s=70.0, printer="a", by="ann", filament=None))
    printer = books.printers["a"]
    assert (printer.attention_reason, printer.alarm) == (None, None) and list_due_notices(
        books, 70.0, 70.0, ()
    ) == []
    books = apply_report(books, make_snapshot(), 80.0)
    assert books.printers["a"].attention_reason == FINDING
