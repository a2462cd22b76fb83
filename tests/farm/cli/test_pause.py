"""What `farm resume` says beside that a print goes on."""

import pytest
from typer.testing import CliRunner

from farm import api
from farm.cli import pause
from farm.cli.main import app


class Daemon:
    """A farm in which one print goes on longer than anybody is there."""

    def __init__(self, _: object) -> None:
        self.told: list[str] = []

    def tell(self, path: str) -> str:
        return path

    def status(self) -> api.Status:
        hours = api.Todo(code="hours", printers=["a"], text="a needs until Fri 19:00")
        clear = api.Todo(code="clear", printers=["b"], text="clear 1 bed: b")
        return api.Status.model_construct(todo=[hours, clear])


def test_a_print_that_goes_on_but_not_to_its_end_is_warned_of(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pause, "Client", Daemon)
    said = CliRunner().invoke(app, ["resume", "a"]).stdout.splitlines()
    assert said == ["a: goes on", "a needs until Fri 19:00"]
