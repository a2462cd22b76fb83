"""Timeline of a job as text."""

import io

from rich.console import Console

from farm import api
from farm.cli.display.timeline import draw_gantt, render_timeline


def make_slot(number, printer, starts, ends):
    return api.SlotView(
        plate=f"4/{number:02d}",
        parts=[f"4/p{number:02d}"],
        printer=printer,
        starts=f"2026-11-21T{starts}:00+00:00",
        ends=f"2026-11-21T{ends}:00+00:00",
        grams=30.0,
        price=0.9,
    )


NOW = "2026-11-21T09:00:00+00:00"
SLOTS = [
    make_slot(1, "um2-01", "10:00", "12:00"),
    make_slot(2, "um2-02", "10:00", "11:00"),
    make_slot(3, "um2-02", "13:00", "14:00"),
]


def test_each_printer_has_one_row_in_the_chart():
    assert draw_gantt(SLOTS, NOW, chart_width=40) == [
        "um2-01  [------01------]",
        "um2-02  [--02--]                [--03--]",
        "        Sat 10:00              Sat 14:00",
    ]


def test_short_plate_in_a_long_night_is_visible():
    lines = draw_gantt(
        [make_slot(1, "a", "00:00", "00:01"), make_slot(2, "b", "00:00", "23:59")], NOW, chart_width=23
    )
    assert lines[0].startswith("a  ") and lines[0].strip() != "a"
    assert len(lines[1]) == len("b  ") + 20
    assert draw_gantt([], NOW) == []


def test_timeline_shows_totals_notices_and_every_plate():
    fields = {"plan": "x", "left": ["4/04"], "notices": ["Scaled."]}
    fields |= {"makespan_s": 14400, "lower_bound_s": 7200, "currency": "GBP"}
    view = api.Timeline(job=4, now=NOW, slots=SLOTS, grams=90.0, price=2.7, **fields)
    console = Console(record=True, width=120, file=io.StringIO())
    console.print(render_timeline(view))
    text = console.export_text()
    assert "3 plates, 4h00 (lower bound 2h00), 90 g, 2.70 GBP" in text
    assert "no printer can print 4/04" in text
    assert text.startswith("Scaled.")
    assert "4/p03  um2-02   Sat 13:00  Sat 14:00  1h00      30     0.90 GBP" in text
