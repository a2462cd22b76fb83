"""`farm queue` with a daemon in memory."""

import pytest
from typer.testing import CliRunner

from farm import api
from farm.cli.commands import queue
from farm.cli.main import app

ENTRY_FIELDS = {"state": "printing", "waiting": 2, "eta": None, "submitted_by": "ann"}


@pytest.fixture
def moves(monkeypatch):
    """Record the requested moves."""
    requests = []

    class Daemon:
        def __init__(self, _):
            pass

        def fetch_queue(self):
            jobs = [api.QueueEntry(id=n, name=f"m{n}.stl", **ENTRY_FIELDS) for n in (7, 3)]
            return api.Queue(now="2026-01-01T00:00:00+00:00", jobs=jobs)

        def move_job(self, number, request):
            requests.append((number, request.to, request.before))
            return self.fetch_queue()

        def reschedule_job(self, number, request):
            requests.append((number, request.at))

    monkeypatch.setattr(queue, "connect", Daemon)
    return requests


def test_jobs_are_listed_in_the_order_of_the_queue(moves):
    lines = CliRunner().invoke(app, ["queue"]).stdout.splitlines()
    assert [line.split()[:3] for line in lines] == [
        ["PLACE", "JOB", "MODEL"],
        ["1", "7", "m7.stl"],
        ["2", "3", "m3.stl"],
    ]
    assert moves == []


def test_job_is_moved_by_direction_or_before_another(moves):
    assert CliRunner().invoke(app, ["queue", "3", "up"]).exit_code == 0
    assert CliRunner().invoke(app, ["queue", "3", "--before", "7"]).exit_code == 0
    assert CliRunner().invoke(app, ["queue", "3", "--at", "fri 22:00"]).exit_code == 0
    assert moves == [(3, "up", None), (3, None, 7), (3, "fri 22:00")]


@pytest.mark.parametrize(
    "arguments",
    [
        ["3"],
        ["3", "up", "--before", "7"],
        ["--before", "7"],
        ["--at", "22:00"],
        ["3", "up", "--at", "22:00"],
        ["3", "sideways"],
    ],
)
def test_move_without_one_target_is_refused(moves, arguments):
    assert CliRunner().invoke(app, ["queue", *arguments]).exit_code == 2
    assert moves == []
