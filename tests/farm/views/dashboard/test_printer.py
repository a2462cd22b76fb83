"""Data of a printer's page."""

import pytest

from farm.errors import NotFoundError
from farm.model import Moment, PrintState, Still, Temperatures
from farm.views.dashboard import describe_printer_page
from farms.dashboard_farm import (
    START_S,
    add_planned_job,
    add_print,
    judge_print,
    make_context,
    make_empty_books,
)

NOW_S = START_S + 1000.0


def make_failed_books():
    books = add_planned_job(make_empty_books(), 1, 2)
    failure_fields = {
        "state": PrintState.FAILED,
        "fault": "thermal_runaway",
        "reason": "the nozzle got colder",
    }
    books = judge_print(add_print(books, "1/01", "a", START_S, 60.0, **failure_fields), "a", START_S + 100.0)
    (name,) = books.prints
    still = Still(moment=Moment.FAILURE, at_s=START_S + 50.0, file="abc.png")
    books.prints[name] = books.prints[name].model_copy(update={"stills": (still,)})
    return books


def describe_page(books, name="a", readings=()):
    return describe_printer_page(make_context(books, NOW_S), name, readings, (), None)


def test_fault_is_shown_with_its_stills_and_temperatures():
    page = describe_page(make_failed_books(), readings=[Temperatures(NOW_S - 60.0, 210, 60, 210, 60)])
    (fault,) = page.faults
    assert (fault.part, fault.fault, fault.text) == ("1/p01", "thermal_runaway", "the nozzle got colder")
    assert [(still.moment, still.file) for still in fault.stills] == [("failure", "print-1-failure.png")]
    assert (page.figures.print_count, page.figures.failed_count) == (1, 1)
    assert [row.part for row in page.prints] == ["1/p01"]
    assert page.chart.max_temperature_c == 210


def test_page_omits_faults_and_prints_of_other_printers():
    page = describe_page(make_failed_books(), "b")
    assert (page.faults, page.prints, page.figures.print_count, page.chart) == ([], [], 0, None)


def test_stills_of_a_pruned_job_are_omitted():
    books = make_failed_books()
    books.jobs[1] = books.jobs[1].model_copy(update={"pruned_s": NOW_S})
    assert describe_page(books).faults[0].stills == ()


def test_printer_that_left_the_fleet_has_no_page():
    with pytest.raises(NotFoundError, match="no printer z"):
        describe_page(make_empty_books("az"), "z")
