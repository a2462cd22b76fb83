"""Commands that work from another host, and those that refuse to, with the reason."""

import pytest
from typer.testing import CliRunner

from farm.cli.command_group import load_commands
from farm.cli.main import app
from farm.cli.options import LOCAL_COMMANDS
from farm.errors import DaemonUnreachable, RefusedError

REMOTE_COMMANDS = {
    "status": [],
    "submit": ["MODEL"],
    "approve": ["1"],
    "queue": [],
    "hosts": [],
    "pause": ["a"],
    "resume": ["a"],
    "cancel": ["1"],
    "reprint": ["1", "p01", "--why", "warped"],
    "history": [],
    "report": ["1"],
    "assembled": ["1", "--minutes", "45"],
    "fetch": ["1"],
    "cleared": ["a"],
    "fail": ["a"],
    "load": ["a", "pla"],
    "maintenance": ["a", "--why", "cleaning"],
}
COMMANDS_WITHOUT_FARM = {"coupon", "decompose", "host", "slice", "worker"}
LOCAL_AND_REMOTE_COMMANDS = {"daemon", "doctor", "discover", "estop"}
URL = "http://127.0.0.1:9"  # nothing listens on the port `discard`


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FARM_STATE", str(tmp_path / "state"))
    (tmp_path / "MODEL").write_text("solid")
    key = tmp_path / "key"
    key.touch(mode=0o600)
    key.write_text("farm_key")
    monkeypatch.setenv("FARM_KEY_FILE", str(key))
    return lambda *arguments: CliRunner().invoke(app, arguments)


def test_every_command_is_remote_or_local():
    assert (
        set(load_commands(app)) - {"setup"}
        == REMOTE_COMMANDS.keys() | LOCAL_COMMANDS.keys() | COMMANDS_WITHOUT_FARM
    )


@pytest.mark.parametrize("command", REMOTE_COMMANDS)
def test_remote_command_calls_the_daemon_at_the_url(run, command):
    result = run(command, *REMOTE_COMMANDS[command], "--url", URL)
    assert isinstance(result.exception, DaemonUnreachable), result.output
    assert URL in str(result.exception)


@pytest.mark.parametrize("command", LOCAL_COMMANDS)
def test_local_command_refuses_a_url_with_the_reason(run, command):
    values = ["a"] if command == "estop" else []
    result = run(command, *values, "--url", URL)
    assert isinstance(result.exception, RefusedError), result.output
    assert LOCAL_COMMANDS[command] in str(result.exception)


@pytest.mark.parametrize("command", sorted(set(LOCAL_COMMANDS) - LOCAL_AND_REMOTE_COMMANDS))
def test_local_command_is_refused_if_farm_url_names_another_farm(run, command, monkeypatch):
    monkeypatch.setenv("FARM_URL", URL)
    assert isinstance(run(command).exception, RefusedError)


def test_emergency_stop_is_possible_if_farm_url_names_another_farm(run, monkeypatch):
    monkeypatch.setenv("FARM_URL", URL)
    result = run("estop", "--json")
    assert not isinstance(result.exception, RefusedError) or "own host" not in str(result.exception)
