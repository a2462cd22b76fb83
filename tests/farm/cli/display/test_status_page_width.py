"""Status page on terminals of several sizes."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.cells import cell_len

from books.example_night import make_night_books, make_status, summarise_status
from farm import api
from farm.cli.display.status_page import render_status
from farm.model import Bed, Hold, HoldCode, PrintState, Verdict

NOW = datetime(2026, 11, 22, 7, 0, tzinfo=UTC)
STATUS = make_status(make_night_books())
WIDTHS = pytest.mark.parametrize("width", [60, 80, 100, 120])
BUSY_HOLD = Hold(code=HoldCode.PRINTER_BUSY, text="um2-01 is printing until Mon 04:00; " + "word " * 20)

TEXTS = st.integers(1, 12).map(lambda number: " ".join(["word", "belt"] * number))
NAMES = st.text("aB1._-", max_size=40).map(lambda rest: f"p{rest}")
TIMES = st.integers(-2000, 0).map(lambda hours: (NOW + timedelta(hours=hours)).isoformat())


def make_progress(plate, remaining_s, share):
    return api.PrintProgress.model_construct(plate=plate, remaining_s=remaining_s, progress=share)


PRINTS = st.builds(make_progress, st.sampled_from(["1/01", "12/03b"]), st.floats(0, 4e5), st.floats(0, 1))
LAST_PRINTS = st.builds(
    api.LastPrint,
    plate=st.just("123/45"),
    state=st.sampled_from([PrintState.DONE, PrintState.FAILED]),
    ended=TIMES,
    off=st.none() | st.floats(-1, 9),
    verdict=st.none(),
)


@st.composite
def printers(draw):
    name = draw(NAMES)
    return STATUS.printers[0].model_copy(
        update={
            "name": name,
            "state": draw(
                st.sampled_from(["idle", "printing", "maintenance", "preparing", "look", "absent"])
            ),
            "bed": draw(st.sampled_from(list(Bed))),
            "reel": api.Reel(
                material=draw(st.sampled_from(["generic_pla", "generic_cpe_plus", "ultimaker_abs_black"])),
                colour=draw(st.none() | TEXTS),
                grams=draw(st.none() | st.floats(0, 2000)),
                nozzle_mm=0.4,
            ),
            "nozzle_c": draw(st.none() | st.floats(20, 260)),
            "targets": api.Targets(nozzle_c=draw(st.none() | st.just(210.0)), bed_c=60.0),
            "print": draw(st.none() | PRINTS),
            "last": draw(st.none() | LAST_PRINTS),
            "maintenance": draw(st.none() | TEXTS),
            "hold": draw(st.none() | st.just(BUSY_HOLD)),
        }
    )


FLEETS = st.lists(printers(), min_size=1, max_size=12, unique_by=lambda printer: printer.name)


def make_view(fleet, **values):
    fleet_view = STATUS.fleet.model_copy(update={"now": NOW.isoformat()})
    return STATUS.model_copy(update={"printers": fleet, "fleet": fleet_view, **values})


def render_lines(view, width=None, height=None):
    return render_status(summarise_status(view), width, height).plain.splitlines()


def make_waiting_job(number, **values):
    values = {"state": "queued", "parts": [], "plates": [], "hold": BUSY_HOLD, "progress": None, **values}
    return STATUS.jobs[0].model_copy(update={"id": number, "name": "box.stl", **values})


@WIDTHS
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
@given(fleet=FLEETS)
def test_lines_fit_the_terminal_and_list_every_printer(width, fleet):
    view = make_view(fleet)
    lines = render_lines(view, width)
    assert all(cell_len(line) <= width for line in lines)
    rows = iter(lines)
    assert any(line.startswith("PRINTER") for line in rows)
    for printer in fleet:
        # The rows are in the order of the fleet, each with its complete name.
        assert any(line.startswith(printer.name) for line in rows)


@WIDTHS
@settings(max_examples=20, suppress_health_check=[HealthCheck.too_slow])
@given(fleet=FLEETS, height=st.integers(4, 40))
def test_watched_page_fits_the_terminal(width, fleet, height):
    jobs = [STATUS.jobs[0], *(make_waiting_job(i) for i in range(2, 30))]
    lines = render_lines(make_view(fleet, jobs=jobs), width, height)
    assert len(lines) <= height
    assert all(cell_len(line) <= width for line in lines)


@WIDTHS
def test_row_of_a_printing_printer_is_complete_at_every_width(width):
    printing_fields = {"state": "printing", "print": make_progress("12/03", 44_000, 0.55), "nozzle_c": 200.0}
    fleet = [
        p.model_copy(update={"targets": api.Targets(nozzle_c=200, bed_c=60), **printing_fields})
        for p in STATUS.printers
    ]
    rows = [line for line in render_lines(make_view(fleet), width) if line.startswith("um2-")]
    for number, row in enumerate(rows, 1):
        assert row.startswith(f"um2-0{number}   printing  12/03  in 12h13 (55 %)")


def test_ended_jobs_are_listed_below_the_printers():
    cancelled_job = STATUS.jobs[0].model_copy(update={"id": 1, "state": "cancelled", "name": "old.stl"})
    lines = render_lines(make_view(STATUS.printers, jobs=[cancelled_job, make_waiting_job(2)]), 80)
    positions = [
        next(i for i, line in enumerate(lines) if line.startswith(head))
        for head in ("JOB 2", "PRINTER", "JOB 1")
    ]
    assert positions == sorted(positions)


def test_jobs_with_the_same_hold_share_one_sentence():
    page = "\n".join(render_lines(make_view([], jobs=[make_waiting_job(i) for i in range(3, 8)])))
    assert page.count(BUSY_HOLD.text.strip()) == 1
    assert "JOBS     3..7 (box.stl (5)): queued, waits: um2-01 is printing" in page


def test_plates_of_several_jobs_with_the_same_hold_share_one_sentence():
    parts = STATUS.jobs[0].parts
    held_jobs = [
        make_waiting_job(
            number,
            state="printing",
            hold=None,
            parts=parts,
            plates=[
                p.model_copy(update={"id": f"{number}/0{i}", "parts": [f"{number}/p0{i}"], "hold": BUSY_HOLD})
                for i, p in enumerate(STATUS.jobs[0].plates, 1)
            ],
        )
        for number in (3, 4)
    ]
    page = "\n".join(render_lines(make_view([], jobs=held_jobs)))
    assert page.count(BUSY_HOLD.text.strip()) == 1
    assert "WAIT     3/p01..05 4/p01..05: um2-01 is printing" in page


def test_empty_task_list_is_not_highlighted():
    line = render_status(summarise_status(make_view([], todo=[]))).split("\n")[1]
    assert line.plain == "DO NOW   nothing"
    assert not any("red" in str(span.style) for span in line.spans)


def test_print_that_ended_last_month_is_shown_with_its_date():
    last_print = api.LastPrint(
        plate="1/01", state=PrintState.DONE, ended="2026-10-30T06:00:00+00:00", off=None, verdict=Verdict.GOOD
    )
    old_printer = STATUS.printers[0].model_copy(update={"last": last_print, "bed": Bed.UNKNOWN})
    assert render_lines(make_view([old_printer]), 80)[-1].startswith(
        "um2-01   remove  1/01  at Fri 30 Oct 06:00"
    )


def make_connect_task(printer, text):
    return api.Todo(code="connect", printers=[printer], text="", brief=f"{printer}: {text}")


def test_printers_with_the_same_problem_are_one_task():
    todo = [
        make_connect_task(name, f"/run/{name}/tty: no such file") for name in ("um2-01", "um2-02", "um2x-01")
    ]
    lines = render_lines(make_view([], todo=[*todo, make_connect_task("um2-05", "no answer")]), 80)
    assert lines[1] == "DO NOW   connect: um2-01..02 um2x-01: /run/um2-01/tty: no such file"
    assert lines[2] == "         connect: um2-05: no answer"


def test_long_tasks_have_a_line_each():
    todo = [
        make_connect_task(name, f"no answer {i} " + "word " * 9)
        for i, name in enumerate(("um2-01", "um2-02"))
    ]
    words = [line.split()[:2] for line in render_lines(make_view([], todo=todo), 80) if "connect" in line]
    assert [line[-1] for line in words] == ["NOW", "um2-02:"]
