"""Subjects of events in the log."""

from __future__ import annotations

from farm.control.log_subjects import find_subjects
from farm.model import Print
from farm.state import Books
from farm.state import events as ev


def test_event_about_a_plate_names_its_job_and_person():
    event = ev.PlateCancelled(at_s=1.0, plate="3/07-2", by="ann")
    assert find_subjects(event, Books()) == {"job": 3, "plate": "3/07-2", "who": "ann"}


def test_event_about_a_print_names_its_job_plate_and_printer():
    books = Books(prints={"u1": Print(id="u1", plate="3/07", job=3, printer="b", assigned_s=0.0)})
    event = ev.PrintWithdrawn(at_s=1.0, print_id="u1", reason="")
    assert find_subjects(event, books) == {"job": 3, "plate": "3/07", "printer": "b"}


def test_event_about_the_farm_has_no_subjects():
    assert find_subjects(ev.ClockSet(at_s=1.0, by_s=3.0), Books()) == {}
