"""Output of `farm web`."""

import json

import pytest
from typer.testing import CliRunner

from farm import api
from farm.cli.commands import web
from farm.cli.main import app as cli
from farm.model import Role

URL = "http://127.0.0.1:8467/login/" + "x" * 43


class Daemon:
    """Stand-in for a daemon that makes links and ends sessions."""

    url = URL

    def __init__(self, _):
        pass

    def make_login_link(self):
        return api.LoginLink(url=self.url, user="ann", role=Role.OPERATE, valid_s=300.0)

    def end_sessions(self):
        return api.EndedSessions(ended=2)


@pytest.fixture(autouse=True)
def daemon(monkeypatch):
    monkeypatch.setattr(web, "Client", Daemon)


def run(*arguments):
    result = CliRunner().invoke(cli, ["web", *arguments])
    assert result.exit_code == 0, result.output
    return result


def test_only_the_link_is_on_stdout():
    result = run()
    assert result.stdout == URL + "\n"
    assert "as ann (operate), once, within 5 min" in result.stderr
    assert "not encrypted" in result.stderr


def test_link_by_https_has_no_warning(monkeypatch):
    monkeypatch.setattr(Daemon, "url", URL.replace("http:", "https:"))
    assert "not encrypted" not in run().stderr


def test_link_and_number_of_ended_sessions_are_printed_as_json():
    assert json.loads(run("--json").stdout)["url"] == URL
    assert json.loads(run("--end-all", "--json").stdout) == {"schema": 1, "ended": 2}
    assert run("--end-all").stdout == "2 sessions ended\n"
