"""Page of a job, rendered without a browser."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

from books.example_night import make_night_books, make_status, make_view_context
from books.make_books import apply_events
from farm import api
from farm.model import Hold, HoldCode, JobOptions, JobState, OwnGcode, PlanProgress, PlanStep, Role, TextTime
from farm.state import events as ev
from farm.views import describe_job
from farm.views.report.decomposition import Report, parse_report
from farm.web.notes import User
from farm.web.pages.jobs.job_page import (
    JobData,
    group_downloads,
    list_gcode_figures,
    list_wait_reasons,
    render_job_page,
    summarise_job,
)
from farm.web.pages.jobs.parts import list_part_rows
from farm.web.pages.sentences import Sentence

TIMES = (TextTime(text="Fri 22:00", at="2026-11-20T22:00:00+01:00"),)
FARM = SimpleNamespace(name="farm", timezone="UTC")
REPORT = b"""{"schema": 9, "unknown": 1,
"joints": [{"a": "p01", "b": "p02", "area_mm2": 450.0, "glued": true}],
"assembly": {"levels": 1, "locked": [["p04", "p05"]], "steps": [{"number": 1, "moved": ["p02"],
"fixed": ["p01", "p03"], "slides": true}]},
"curve": [{"printers": 2, "makespan_s": 7200.0}, {"printers": 4, "makespan_s": 3600.0},
{"printers": 5, "makespan_s": 3000.0}]}"""


def make_data(books, **changes):
    context = make_view_context(books)
    job = describe_job(context, books.get_job(1)).model_copy(update=changes)
    return JobData(job, make_status(books).printers, report=parse_report(REPORT))


def list_rows(data, role=Role.OPERATE):
    return {row.name: row for row in list_part_rows(data.job, data.printers, {}, role)}


def render_page(data, role=Role.OPERATE):
    return render_job_page(data, FARM, User("ann", role))


def list_paths(page):
    return set(re.findall(r'action="([^"]+)"', page)) - {"/logout"}


def test_rows_show_the_state_of_each_part_with_its_expected_and_actual_times():
    rows = list_rows(make_data(make_night_books()))
    assert {name: row.state for name, row in rows.items()} == {
        "p01": "printed",
        "p02": "printed",
        "p03": "printed",
        "p04": "failed",
        "p05": "printing",
    }
    first_row, failed_row, last_row = rows["p01"], rows["p04"], rows["p05"]
    assert (first_row.expected_time, first_row.current_estimate, first_row.actual_time) == (
        "100 s",
        "",
        "102 s (+2 %)",
    )
    assert (first_row.remark, failed_row.reason.text) == ("on the bed of um2-01", "it does not get warm")
    assert (last_row.progress, last_row.current_estimate, last_row.actual_time) == (1.0, "7h00", "")


def make_slot(printer="um2-01", plate="1/01"):
    return api.SlotView(
        plate=plate,
        parts=["1/p01"],
        printer=printer,
        starts="1970-01-01T08:00:00+00:00",
        ends="1970-01-01T09:00:00+00:00",
        grams=3.0,
        price=None,
    )


def test_row_has_the_printer_and_the_end_of_the_forecast():
    data = make_data(make_night_books())
    slots = {"1/01": make_slot("um2-07")}
    row = list_part_rows(data.job, data.printers, slots, Role.LOOK)[0]
    assert (row.printer, row.end) == ("um2-07", slots["1/01"].ends)


def test_times_of_a_job_are_elements_that_a_script_shows_in_the_zone_of_the_reader():
    data = make_data(make_night_books(), eta="1970-01-01T09:00:00+00:00")
    page = render_page(data)
    assert 'printed, ends <time datetime="1970-01-01T09:00:00+00:00">Thu 09:00</time>, in 2h00.' in page
    assert f'<dt>Submitted</dt><dd><time datetime="{data.job.submitted}">' in page


def test_reasons_mark_commands_and_omit_the_last_one_which_has_a_button():
    data = make_data(make_night_books())
    hold = Hold(code=HoldCode.PRINTER_BUSY, text="load `a reel`, then `farm load um2-01`")
    plates = [data.job.plates[0].model_copy(update={"hold": hold}), *data.job.plates[1:]]
    page = render_page(replace(data, job=data.job.model_copy(update={"plates": plates})))
    assert page.count("load <code>a reel</code><") == 2  # once for the job, and once for the part
    assert "`" not in page


def test_part_on_a_bed_is_judged_where_its_bed_is_cleared():
    books = make_night_books()
    actions = {
        name: [(a.path, dict(a.fields)) for a in row.actions]
        for name, row in list_rows(make_data(books)).items()
    }
    assert actions["p01"][:2] == [
        ("/printers/um2-01/cleared", {"seen": "um2-01 1", "good": "1/p01"}),
        ("/printers/um2-01/cleared", {"seen": "um2-01 1", "bad": "true"}),
    ]
    assert actions["p04"][:2] == [
        ("/printers/um2-04/cleared", {"seen": "um2-04 4", "good": "1/p04"}),
        ("/printers/um2-04/cleared", {"seen": "um2-04 4"}),
    ]
    books, _ = apply_events(books, ev.BedCleared(at_s=300.0, printer="um2-01", by="ann"))
    assert [a.label for a in list_rows(make_data(books))["p01"].actions] == ["Print again"]
    assert not any(
        "cleared" in a.path for a in list_rows(make_data(make_night_books()), Role.PRINT)["p01"].actions
    )


def test_part_is_shown_only_on_the_bed_of_its_last_print():
    data = make_data(make_night_books())
    first_printer = next(printer for printer in data.printers if printer.name == "um2-01")
    # The last print of that printer was of the same plate.
    failed_printer = first_printer.model_copy(update={"name": "um2-09"})
    rows = list_rows(replace(data, printers=[*data.printers, failed_printer]))
    assert rows["p01"].remark == "on the bed of um2-01"
    assert not any("um2-09" in action.path for row in rows.values() for action in row.actions)


def test_reader_who_only_looks_has_no_buttons():
    page = render_page(make_data(make_night_books()), Role.LOOK)
    assert list_paths(page) == set()
    assert "Commands for" not in page


def test_printing_job_is_paused_or_resumed_and_cancelling_needs_a_second_click():
    page = render_page(make_data(make_night_books()))
    assert {"/jobs/1/pause", "/jobs/1/cancel", "/jobs/1/parts/p05/pause"} <= list_paths(page)
    assert re.search(r"<details><summary>Cancel job 1…</summary><form[^>]*action=\"/jobs/1/cancel\"", page)
    assert "/jobs/1/resume" in list_paths(render_page(make_data(make_night_books(), paused=True)))


def test_dry_run_offers_print_keep_discard_and_its_curve():
    dry_run_options = JobOptions(dry_run=True, hold=True)
    data = make_data(make_night_books(), state=JobState.HELD, options=dry_run_options, plan="abc")
    slots = [make_slot()]
    timeline = api.Timeline(
        job=1,
        now=data.job.now,
        plan="abc",
        slots=slots,
        left=[],
        notices=[],
        makespan_s=3600.0,
        lower_bound_s=0.0,
        grams=3.0,
        price=None,
        currency=None,
    )
    page = render_page(replace(data, timeline=timeline, time_curve_job=7))
    assert list_paths(page) == {"/jobs/1/release", "/jobs/1/keep", "/jobs/1/cancel", "/jobs/1/replan"}
    assert '<input type="hidden" name="plan" value="abc">' in page
    assert '<input type="hidden" name="curve" value="7">' in page
    assert "2 printers: about 2h00, ends Thu 10:00" in page  # counted from the plan's start
    assert re.findall(r'<option value="(\d+)"', page) == ["2", "4", "5"]
    assert page.count("<circle") == 3
    assert "bar-expected" in page


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"state": JobState.QUEUED}, "It waits to be planned."),
        (
            {"state": JobState.QUEUED, "hold": Hold(code=HoldCode.OUTAGE, text="after the outage")},
            "It waits to be planned: after the outage.",
        ),
        ({"state": JobState.PLANNING}, "It is being planned."),
        (
            {
                "state": JobState.PLANNING,
                "progress": PlanProgress(step=PlanStep.DECOMPOSING, share=0.4, remaining_s=90.0),
            },
            "Decomposing 40 %, up to about 90 s left.",
        ),
        (
            {"state": JobState.HELD, "expected_s": 3600.0},
            "Planned: 5 parts on 5 printers, 1h00, 15 g. Nothing prints before it is approved.",
        ),
        ({"paused": True, "eta": None}, "Paused: 3 of 5 parts printed."),
        (
            {"state": JobState.PRINTED},
            "Every part is printed: take the parts off and report which are good.",
        ),
        ({"state": JobState.DONE}, "Every part is printed and good."),
        ({"state": JobState.FAILED, "reason": "no fit"}, "It has failed: no fit."),
        ({"state": JobState.CANCELLED, "reason": "cancelled by ann"}, "It was cancelled: cancelled by ann."),
    ],
)
def test_first_sentence_describes_the_progress_of_the_job(changes, text):
    data = make_data(make_night_books(), **changes)
    assert summarise_job(data.job, None) == text
    assert f"</span> {text}</p>" in render_page(data)


def test_plates_that_wait_for_the_same_reason_are_named_together():
    data = make_data(make_night_books())
    hold = Hold(code=HoldCode.PRINTER_BUSY, text="its printers are busy", times=TIMES)
    plates = [plate.model_copy(update={"hold": hold}) for plate in data.job.plates[:3]] + data.job.plates[3:]
    job = data.job.model_copy(update={"plates": plates})
    assert list_wait_reasons(job) == [Sentence("1/p01..03: its printers are busy", TIMES)]
    assert "its printers are busy" in render_page(replace(data, job=job))


def test_plates_that_no_printer_can_take_are_named():
    job = make_data(
        make_night_books(), hold=Hold(code=HoldCode.APPROVAL, text="held until it is approved")
    ).job
    timeline = api.Timeline(
        job=1,
        now=job.now,
        plan="",
        slots=[],
        left=["1/p01", "1/p02"],
        notices=[],
        makespan_s=0.0,
        lower_bound_s=0.0,
        grams=0.0,
        price=None,
        currency=None,
    )
    # The approval is in the summary.
    assert list_wait_reasons(job, timeline) == [Sentence("no printer can print 1/p01..02")]
    assert list_wait_reasons(job) == []


def test_assembly_shows_steps_joints_and_parts_without_an_order():
    page = render_page(replace(make_data(make_night_books()), files=("instructions.html",)))
    assert "Glue p02 to p01, p03; the faces slide along each other" in page
    assert "No order is known in which p04, p05 can be assembled." in page
    assert "4.5 cm²" in page
    assert 'href="/jobs/1/instructions"' in page


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b'{"joints": 3}', b"\xff"])
def test_report_that_cannot_be_read_is_empty(text):
    assert parse_report(text) == Report()


def test_files_are_grouped_and_linked_as_downloads():
    names = ("p01.stl", "plate-01.gcode", "assembly.glb", "decomposition-p02.json", "print-a-end.jpg")
    groups = group_downloads(names)
    assert {title: [name for name, _ in rows] for title, rows in groups.items()} == {
        "Model": ["assembly.glb", "decomposition-p02.json"],
        "Parts (STL)": ["p01.stl"],
        "G-code": ["plate-01.gcode"],
        "Pictures": ["print-a-end.jpg"],
    }
    assert 'href="/api/v1/jobs/1/files/p01.stl" download' in render_page(
        replace(make_data(make_night_books()), files=names)
    )


def test_text_of_users_is_escaped():
    page = render_page(make_data(make_night_books(), name="<script>x</script>", repairs=["<b>hole</b>"]))
    assert "<script>x" not in page
    assert "&lt;script&gt;x" in page
    assert "&lt;b&gt;hole" in page


def test_own_gcode_is_shown_with_size_layers_and_time():
    books = make_night_books()
    own_gcode = OwnGcode(nozzle_mm=0.4, min_mm=(-10.0, -20.0, 0.0), max_mm=(10.0, 20.0, 30.4))
    job = books.get_job(1).model_copy(update={"own_gcode": own_gcode})
    figures = [("size", "20 × 40 × 30 mm"), ("layers", "10"), ("time of the moves", "90 s")]
    assert list_gcode_figures(job, books.list_plates(job)) == figures
    assert list_gcode_figures(job, ()) == figures[:1]
    assert list_gcode_figures(books.get_job(1), books.list_plates(job)) == []
    page = render_page(replace(make_data(books), gcode_figures=figures))
    assert "<dt>Layers</dt><dd>10</dd>" in page


def test_time_of_gluing_is_requested_only_for_a_model_that_was_cut():
    data, path = make_data(make_night_books(), state=JobState.PRINTED), "/jobs/1/assembled"
    assert path in list_paths(render_page(data))
    copies = [part.model_copy(update={"copy_number": n}) for n, part in enumerate(data.job.parts, 1)]
    whole_data = replace(data, job=data.job.model_copy(update={"parts": copies}))
    assert path not in list_paths(render_page(whole_data))


def test_printers_stay_in_view_beside_the_timeline():
    page = render_page(make_data(make_night_books()))
    names, _, bars = page.partition('class="gantt names"')[2].partition('class="wide"')
    assert re.findall(r">(um2-\d+)<title", names) == [f"um2-0{n}" for n in range(1, 6)]
    assert not re.findall(r">um2-\d+</text>", bars.partition("</svg>")[0])


def test_reason_of_a_failed_part_is_shown_before_warnings_of_its_slice():
    data = make_data(make_night_books())
    warned_plates = [plate.model_copy(update={"warnings": ["thin", "tall"]}) for plate in data.job.plates]
    warned_data = replace(data, job=data.job.model_copy(update={"plates": warned_plates}))
    failed_row = list_rows(warned_data)["p04"]
    assert (failed_row.reason.text, failed_row.warnings) == ("it does not get warm", ["thin", "tall"])
    page = render_page(warned_data)
    assert page.index("it does not get warm") < page.index("thin; tall</details>", page.index('id="p04"'))


def test_job_that_could_not_be_planned_shows_the_next_step_and_no_empty_figures():
    data = make_data(
        make_night_books(), state=JobState.FAILED, reason="it is not a solid", plates=[], parts=[]
    )
    page = render_page(data)
    assert "It has failed: it is not a solid. Correct that, then submit it again." in page
    assert "Plates printed" not in page
    assert "Wasted" not in page
