"""Copies of a model from submission to the last cleared bed, by the daemon's rules."""

import io
from pathlib import Path

import pytest
from rich.console import Console

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, PLUS_MODEL, Farm
from farm.cli.display.job_page import render_job
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    FilamentState,
    JobOptions,
    JobState,
    Link,
    PrintState,
    Verdict,
)
from farm.paths import StateFolder
from farm.planning.parts.copies import multiply_plan
from farm.planning.plan import DecomposeTask, Plan
from farm.views import describe_job, list_history
from hosts.manual_clock import ManualClock

STATE = StateFolder(Path("/state"))
OPTIONS = JobOptions(copies=2, name="vase", note="for Ada")


@pytest.fixture
def farm(tmp_path):
    """Make a farm with two copies of a model of two parts, on four printers."""
    farm = Farm(tmp_path, models=(PLUS_MODEL,) * 4, clock=ManualClock(1e9))
    farm.report_ready("a", "b", "c", "d")
    farm.jobs.submit("r" * 8, "vase.stl", INSPECTED_MODEL, OPTIONS)
    event = make_plan_event(plates=2)
    single_plan = Plan(event.parts, event.plates, event.repairs, 1.0, 180.0)
    task = DecomposeTask(1, tmp_path, OPTIONS, farm.controller.fleet.printers, 1, tmp_path)
    farm.controller.on_plan(1, multiply_plan(single_plan, task))
    return farm


def end_print(farm, plate, state=PrintState.DONE):
    """End the print of a plate after 100 s."""
    books = farm.controller.books
    attempt = next(p for p in books.list_open_prints() if p.plate == plate)
    started_s = farm.controller.clock.now_s
    farm.controller.clock.now_s += 100.0
    report = AgentPrint(
        print_id=attempt.id,
        state=state,
        fault=None,
        reason=None,
        progress_s=90.0,
        print_time_s=90.0,
        extruded=True,
        started_s=started_s,
        ended_s=started_s + 100.0,
    )
    idle_fields = {"link": Link.READY, "agent_pid": 9, "filament": FilamentState.PARKED}
    farm.controller.on_snapshot(AgentSnapshot(printer=attempt.printer, print=report, **idle_fields))
    farm.controller.clock.now_s = started_s
    return attempt.printer


def describe_first_job(farm):
    return describe_job(farm.build_view_context(STATE), farm.controller.books.get_job(1))


def test_all_copies_print_side_by_side(farm):
    books = farm.controller.books
    assert {p.plate: p.printer for p in books.list_open_prints()}.keys() == {
        "1/01.1",
        "1/01.2",
        "1/02.1",
        "1/02.2",
    }
    job_view = describe_first_job(farm)
    assert [(part.id, part.copy_number) for part in job_view.parts] == [
        ("1/p01.1", 1),
        ("1/p02.1", 1),
        ("1/p01.2", 2),
        ("1/p02.2", 2),
    ]
    assert (job_view.name, job_view.serial_s, job_view.printed_copies) == ("vase", 360.0, 0)
    assert job_view.speedup == pytest.approx(3.6)  # compared with a single printer that prints both copies


def test_only_the_failed_part_of_a_copy_is_printed_again(farm):
    for plate in ("1/01.1", "1/02.1", "1/01.2"):
        farm.clear_bed(end_print(farm, plate))
    printer = end_print(farm, "1/02.2")
    farm.clear_bed(printer, verdict=Verdict.BAD, reason="fell over")
    assert [p.plate for p in farm.controller.books.list_open_prints()] == ["1/02.2"]
    job_view = describe_first_job(farm)
    assert (job_view.printed, job_view.good, job_view.printed_copies) == (3, 3, 1)
    screen = Console(file=io.StringIO(), width=100)
    screen.print(render_job(job_view, 100))
    page = screen.file.getvalue()
    for text in ("vase", "for Ada", "1 of 2", "1/p02.2", "attempt 2"):
        assert text in page
    farm.clear_bed(end_print(farm, "1/02.2"))
    assert farm.controller.books.get_job(1).state is JobState.DONE
    assert describe_first_job(farm).printed_copies == 2


def test_part_of_a_copy_is_named_with_its_number(farm):
    end_print(farm, "1/01.2")
    assert farm.parts.reprint(1, "p01.2", "scratched", "ann") == "1/p01.2"
    assert farm.parts.cancel(1, "2.1", "ann") == "1/p02.1"


def test_history_shows_the_note_of_a_job(farm):
    end_print(farm, "1/01.1")
    (row,) = list_history(farm.build_view_context(STATE))
    assert (row.part, row.name, row.note) == ("1/p01.1", "vase", "for Ada")
