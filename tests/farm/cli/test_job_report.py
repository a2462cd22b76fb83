"""Report of a job, as the command line renders it."""

from types import SimpleNamespace

import pytest

from books.example_night import make_night_books, make_status
from farm.cli.job_report import find_local_file, render_report


@pytest.mark.parametrize("zone", ["UTC", "Europe/London", "Asia/Kathmandu"])
def test_page_names_the_time_zone_of_the_fleet(zone):
    status = make_status(make_night_books())
    status = status.model_copy(update={"fleet": status.fleet.model_copy(update={"timezone": zone})})
    client = SimpleNamespace(
        fetch_job=lambda _: SimpleNamespace(job=status.jobs[0]),
        fetch_status=lambda: status,
        fetch_history=lambda *_: SimpleNamespace(prints=[]),
    )
    assert f"the farm's time zone, {zone}." in render_report(client, 1, find_local_file).text
