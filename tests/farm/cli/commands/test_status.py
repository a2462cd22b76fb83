"""Commands that change nothing."""

import pytest
from typer.testing import CliRunner

from farm import api
from farm.cli.commands import status
from farm.cli.main import app


class Daemon:
    """Daemon without ended prints."""

    def __init__(self, _: object) -> None:
        pass

    def history(self, job: int | None, printer: str | None, count: int) -> api.History:
        return api.History(now="2026-11-22T07:00:00+00:00", prints=[])


@pytest.mark.parametrize(("options", "output"), [([], "no print has ended\n"), (["--json"], '"prints": []')])
def test_empty_history_is_reported_in_a_sentence(monkeypatch: pytest.MonkeyPatch, options, output):
    monkeypatch.setattr(status, "connect", Daemon)
    assert output in CliRunner().invoke(app, ["history", *options]).stdout
