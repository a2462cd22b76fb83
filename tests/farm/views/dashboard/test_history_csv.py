"""Ended prints as CSV."""

import csv
from io import StringIO

from hypothesis import given
from hypothesis import strategies as st

from farm import api
from farm.model import PrintState
from farm.text import flatten_text
from farm.views.dashboard.history import write_csv

TEXT = st.text(max_size=20) | st.sampled_from(
    ["=1+1", "+A1", "-2+3", "@SUM(A1)", "\t=1", " =1", '"=1', "a,b\n=c"]
)


def make_row(**changes):
    fields = {
        "part": "1/p01", "printer": "a", "state": PrintState.DONE, "fault": None, "reason": None,
        "verdict": None, "why": None, "started": None, "ended": None, "job": 1, "name": "m.stl", "note": None,
        "submitted_by": None,
        "took_s": 3600.0, "expected_s": 3500.5, "grams": 12.25, "wasted": False,
    }  # fmt: skip
    return api.HistoryRow(**{**fields, **changes})


def read_csv(text):
    return list(csv.DictReader(StringIO(text, newline="")))


@given(st.lists(st.tuples(TEXT, TEXT, TEXT), max_size=5))
def test_text_is_kept_and_no_cell_is_a_formula(texts):
    rows = [make_row(name=name, reason=reason, note=note) for name, reason, note in texts]
    rows_read = read_csv(write_csv(rows))
    assert len(rows_read) == len(rows)
    for line, texts_of_row in zip(rows_read, texts, strict=True):
        assert not any(cell.lstrip().startswith(("=", "+", "-", "@")) for cell in line.values())
        shown_texts = [line[name].removeprefix("'") for name in ("name", "reason", "note")]
        assert shown_texts == [flatten_text(text).removeprefix("'") for text in texts_of_row]


def test_numbers_stay_numbers():
    (line,) = read_csv(write_csv([make_row(grams=12.25, wasted=True)]))
    assert (line["took_s"], line["expected_s"], line["grams"], line["wasted"]) == (
        "3600",
        "3500.5",
        "12.25",
        "yes",
    )
    assert (line["state"], line["verdict"]) == ("done", "")
