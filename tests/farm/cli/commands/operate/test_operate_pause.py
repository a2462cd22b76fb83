"""Output of `farm resume` and `farm pause`."""

import pytest
from typer.testing import CliRunner

from farm import api
from farm.cli.commands import operate
from farm.cli.main import app


class FakeDaemon:
    """Farm in which a print lasts longer than the attended hours."""

    def __init__(self, _: object) -> None:
        self.targets: list[str] = []

    def send_command(self, path: str) -> str:
        return {"/jobs/3/parts/p01/pause": "um2-01"}.get(path, "")

    def fetch_status_summary(self) -> api.StatusSummary:
        hours_task = api.Todo(code="hours", printers=["a"], text="a needs until Fri 19:00")
        clear_task = api.Todo(code="clear", printers=["b"], text="clear 1 bed: b")
        return api.StatusSummary.model_construct(todo=[hours_task, clear_task])


def test_print_resumed_too_late_gets_a_warning(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(operate, "connect", FakeDaemon)
    output = CliRunner().invoke(app, ["resume", "a"]).stdout.splitlines()
    assert output == ["a: resumed", "a needs until Fri 19:00"]


@pytest.mark.parametrize(
    ("target", "output"),
    [
        ("3", "job 3: pausing; none of its waiting parts will start; continue with `farm resume 3`"),
        ("3/p01", "3/p01: pausing on um2-01; continue with `farm resume 3/p01`"),
        ("3/p02", "3/p02: will not start; continue with `farm resume 3/p02`"),
        ("um2-01", "um2-01: pausing; continue with `farm resume um2-01`"),
    ],
)
def test_pause_is_reported(target: str, output: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(operate, "connect", FakeDaemon)
    assert CliRunner().invoke(app, ["pause", target]).stdout == f"{output}\n"
