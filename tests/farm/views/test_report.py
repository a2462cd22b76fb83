"""Report of a job on one page: Gantt chart, failures and parts."""

import io
import json
import re
from dataclasses import replace
from datetime import datetime, timedelta
from xml.etree import ElementTree

import trimesh
from rich.console import Console

from books.example_night import make_night_books, make_view_context
from books.make_books import apply_events
from farm import api
from farm.cli.display import render_job
from farm.model import Still, Verdict
from farm.state import events as ev
from farm.upkeep.part_pictures import draw_part
from farm.views import describe_job, list_history
from farm.views.charts import Bar, lay_out_gantt, list_bars
from farm.views.report import JobContents, list_figures, render_page
from farm.views.report.decomposition import parse_report
from model_files.make_stl import write_stl_bytes

PNG = b"\x89PNG\r\n\x1a\n"


def make_report(books, **changes):
    context = make_view_context(books)
    view = describe_job(context, books.get_job(1)).model_copy(update=changes)
    now_time = datetime.fromisoformat(context.format_time(context.now_s))
    return view, list_history(context), now_time


def test_bar_of_every_print_has_the_colour_of_its_outcome():
    books, _ = apply_events(
        make_night_books(),
        ev.BedCleared(at_s=300.0, printer="um2-01", by="ann"),
        ev.BedCleared(at_s=300.0, printer="um2-02", by="ann", verdict=Verdict.BAD, why="warped"),
    )
    job, other_rows, now_time = make_report(books)
    bars = list_bars(job, other_rows, now_time)
    assert {bar.printer: bar.kind for bar in bars} == {
        "um2-01": "good",
        "um2-02": "bad",
        "um2-03": "printed",
        "um2-04": "failed",
        "um2-05": "printing",
    }
    svg = render_page(job, other_rows, now_time, (), JobContents())
    picture = ElementTree.fromstring(svg[svg.index("<svg") : svg.index("</svg>") + 6])
    rects = list(picture.iter("rect"))
    assert len(rects) == 5
    groups = {group.get("class") for group in picture.iter("g")}
    assert groups == {f"bar-{kind}" for kind in ("good", "bad", "printed", "failed", "printing")}
    widths = [float(rect.get("width")) for rect in rects]
    assert widths[0] == widths[1] == widths[2] > widths[3]  # three prints of 102 s, and one of 45 s
    assert "1/p04 on um2-04: failed, it does not get warm" in svg


def test_stills_of_a_print_are_shown_by_time_and_a_missing_one_is_omitted():
    books = make_night_books()
    attempt = next(row for row in books.prints.values() if row.printer == "um2-01")
    stills = {"end": 300.0, "first_layer": 120.0, "failure": 400.0}
    for moment, at_s in stills.items():
        still = Still(moment=moment, at_s=at_s, file=f"{moment}.jpg")
        books, _ = apply_events(books, ev.StillKept(at_s=at_s, print_id=attempt.id, still=still))
    view, rows, now_time = make_report(books)
    paths = {still.moment: still.file for row in view.prints for still in row.stills}
    pictures = {paths["end"]: PNG, paths["first_layer"]: b"\xff\xd8\xff"}
    page = render_page(view, rows, now_time, list_figures(view), JobContents(pictures))
    captions = re.findall(r"<figcaption><b>1/p01 on um2-01</b> ([a-z ]+)<br>", page)
    assert captions == ["first layer", "end"]
    assert page.count("data:image/jpeg;base64,") == page.count("data:image/png;base64,") == 1
    books = make_books_without_files(books)
    view, *_ = make_report(books)
    assert [still.file for row in view.prints for still in row.stills] == [None] * 3


def test_steps_of_the_assembly_are_listed_with_codes_pins_and_seams():
    view, rows, now_time = make_report(make_night_books())
    step = {
        "number": 1, "moved": ["p02"], "fixed": ["p01"], "seam_mm": 1234.4, "pins": [2, 1, 3],
        "codes": [{"part": "p01", "text": "1-2^"}, {"part": "p02", "text": ".."}],
    }  # fmt: skip
    decomposition = {
        "assembly": {"steps": [step]}, "seam_mm": 1300.0, "thin_rims": "a rim <is> thin",
    }  # fmt: skip
    key = {"id": 3, "length_mm": 8.0, "diameter_mm": 1.75, "kind": "key"}
    decomposition["connectors"] = {
        "pins": [{"id": 1, "length_mm": 6.98}, {"id": 2, "length_mm": 12.965}, key]
    }
    report = parse_report(json.dumps(decomposition).encode())
    page = render_page(view, rows, now_time, list_figures(view), JobContents(decomposition=report))
    cells = re.findall(r"<td>([^<]*)</td>", page[page.index('<table class="steps">') :])
    assert cells == ["1", "p02", "p01", "1-2, ●●", "13, 7, 8 × 1.75", "1,234"]
    assert "1,300 mm of seam are visible" in page and "a rim &lt;is&gt; thin" in page
    assert "<th>marks on the faces</th><th>pins, mm</th>" in page
    assert "Assembly" not in render_page(view, rows, now_time, list_figures(view), JobContents())
    decomposition["assembly"] = {"steps": [{"number": 1, "moved": ["p02"], "fixed": ["p01"], "seam_mm": 5.0}]}
    report = parse_report(json.dumps(decomposition).encode())
    page = render_page(view, rows, now_time, list_figures(view), JobContents(decomposition=report))
    assert "<th>onto</th><th>seam, mm</th></tr>" in page and "<td>p01</td><td>5</td></tr>" in page


def make_books_without_files(books):
    return replace(books, jobs={1: books.jobs[1].model_copy(update={"pruned_s": 1.0})})


def test_chart_includes_prints_of_other_jobs():
    view, rows, now_time = make_report(make_night_books())
    other_row = rows[0].model_copy(update={"job": 2, "printer": "um2-05"})
    assert [bar.kind for bar in list_bars(view, [*rows, other_row], now_time)].count("another job") == 1
    later_row = other_row.model_copy(
        update={"started": "1970-01-02T00:00:00+00:00", "ended": "1970-01-02T01:00:00+00:00"}
    )
    assert "another job" not in [bar.kind for bar in list_bars(view, [later_row], now_time)]


def test_page_is_one_file_with_failures_and_escaped_names():
    view, rows, now_time = make_report(make_night_books(), name="<script>bunny</script>")
    text = render_page(view, rows, now_time, list_figures(view), JobContents({"1/p01": PNG}, PNG))
    assert "<script" not in text
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    assert text.count("data:image/png;base64,") == 2
    assert (
        "<td>1/p04</td><td>um2-04</td><td>Thu 01 Jan 00:00</td><td>failed</td><td>it does not get warm</td>"
        in text
    )
    assert "plates printed</td><td>3 of 5; good 0" in text
    assert text.count("<br>102 s, expected 100 s") == 3  # the printed parts
    assert text.count("<br>expected 100 s") == 2


def test_unprinted_job_has_a_page():
    view, rows, now_time = make_report(make_night_books(), parts=[], plates=[])
    text = render_page(view, rows, now_time, list_figures(view), JobContents())
    assert "Nothing has been printed yet" in text


def test_report_and_job_page_name_the_runs_of_a_job_that_was_printed_again():
    first_run = {"started": "2026-11-21T20:00:00+01:00", "ended": "2026-11-22T06:00:00+01:00"}
    runs = [api.RunView(**first_run), api.RunView(started="2026-11-23T09:00:00+01:00", ended=None)]
    view, _, _ = make_report(make_night_books(), runs=runs, now="2026-11-23T10:00:00+01:00")
    text = "Sat 20:00 to Sun 06:00, Mon 09:00 to now"
    assert dict(list_figures(view))["printed in runs"] == f"{text}; the time between them is not counted"
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(render_job(view))
    assert text in console.export_text()


def test_part_has_a_picture_and_own_g_code_has_none(tmp_path):
    stl = tmp_path / "part.stl"
    stl.write_bytes(write_stl_bytes(trimesh.creation.box((20.0, 10.0, 30.0))))
    assert draw_part(stl).startswith(PNG)
    assert draw_part(tmp_path / "plate.gcode") is None


def test_last_time_mark_is_inside_the_chart():
    start = datetime.fromisoformat("2026-11-22T00:00:00+00:00")
    bar = Bar("um2-01", start, start + timedelta(hours=7), "good", "01", "")
    gantt = lay_out_gantt([bar])
    half_text_px = 35
    assert gantt.marks[-1].text == "Sun 07:00"
    assert gantt.marks[-1].x + half_text_px <= gantt.width
