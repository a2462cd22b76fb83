"""Progress of a job as lines."""

import io

from hypothesis import given
from hypothesis import strategies as st

from books.example_night import make_night_books, make_status
from farm.cli.display.console import open_console
from farm.cli.display.progress import ProgressLines
from farm.model import PlanProgress, PlanStep

JOB = (
    make_status(make_night_books())
    .jobs[0]
    .model_copy(
        update={"parts": [], "plates": [], "printed": 0, "expected_s": None, "waits_for_person": False}
    )
)


def print_progress(*steps):
    screen = open_console()
    screen.width, screen.file, screen.record = 120, io.StringIO(), True
    lines = ProgressLines(screen, quiet=False)
    for step in steps:
        lines.update(JOB.model_copy(update={"progress": step}))
    return [line.strip() for line in screen.export_text().splitlines()]


def make_progress(share, remaining_s):
    return PlanProgress(step=PlanStep.DECOMPOSING, share=share, remaining_s=remaining_s)


def test_search_prints_a_line_for_each_quarter():
    steps = [
        make_progress(None, None),
        make_progress(0.01, 99.0),
        make_progress(0.25, 30.0),
        make_progress(0.3, 28.0),
        make_progress(1.0, 0.2),
    ]
    assert print_progress(*steps, PlanProgress(step=PlanStep.REBALANCING)) == [
        "decomposing",
        "decomposing 0 %",
        "decomposing 25 %, up to about 30 s left",
        "decomposing 100 %",
        "balancing the parts by their sliced times",
    ]


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.none() | st.floats(0.0, 1e6))))
def test_search_prints_at_most_five_lines(steps):
    assert len(print_progress(*(make_progress(share, remaining_s) for share, remaining_s in steps))) <= 5
