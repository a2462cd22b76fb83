"""`farm key`, and commands that reach a farm by its URL."""

import pytest
from typer.testing import CliRunner

from farm import api
from farm.cli.client import read_address
from farm.cli.commands import keys
from farm.cli.main import app as cli
from farm.errors import FarmError
from farm.model import KeyKind, Role

KEY_TEXT = "farm_abcd2345_" + "x" * 43


class Daemon:
    """Stand-in for a daemon that has one key and no network address."""

    network = api.NetworkView(address=None, problem=None)

    def __init__(self, _):
        self.requests = []

    def add_key(self, request):
        Daemon.request = request
        return api.NewKey(id="abcd2345", text=KEY_TEXT, role=request.role)

    def fetch_keys(self):
        key = api.KeyView(
            id="abcd2345",
            kind=KeyKind.KEY,
            name="ann",
            role=Role.LOOK,
            valid=True,
            by="bob",
            created="2026-11-20T10:00:00+00:00",
            used=None,
            expires="2026-11-30T10:00:00+00:00",
            revoked=None,
        )
        return api.Keys(now="2026-11-20T11:00:00+00:00", network=self.network, keys=[key])

    def revoke_key(self, name):
        Daemon.revoked_name = name


@pytest.fixture(autouse=True)
def daemon(monkeypatch):
    monkeypatch.setattr(keys, "Client", Daemon)


def run(*arguments):
    result = CliRunner().invoke(cli, ["key", *arguments])
    assert result.exit_code == 0, result.output
    return result


def test_only_the_new_key_is_on_stdout(daemon):
    result = run("add", "ann", "--role", "look", "--expires", "4w")
    assert result.stdout == KEY_TEXT + "\n"
    assert "shown only now" in result.stderr
    assert "write `web: {}` into fleet.yaml" in result.stderr
    assert Daemon.request == api.KeyRequest(name="ann", role=Role.LOOK, days=28)


def test_keys_are_listed_and_revoked_by_id(daemon):
    output = run().stdout
    assert output.startswith("network: off\n")
    assert "abcd2345" in output
    assert "look" in output
    assert "valid until Mon 30 Nov 10:00" in output
    run("revoke", "abcd2345")
    assert Daemon.revoked_name == "abcd2345"


@pytest.mark.parametrize(
    "arguments", [["add"], ["add", "ann", "--expires", "soon"], ["add", "ann", "--expires", "0d"]]
)
def test_invalid_request_is_refused_without_a_call_to_the_daemon(arguments):
    result = CliRunner().invoke(cli, ["key", *arguments])
    assert result.exit_code == 2


@pytest.mark.parametrize(
    ("url", "expected_text"),
    [
        ("farm.lab:8467", "is not the address"),
        ("ftp://farm", "is not the address"),
        ("https://user:word@farm", "is not the address"),
    ],
)
def test_wrong_url_is_named(tmp_path, url, expected_text):
    with pytest.raises(FarmError, match=expected_text):
        read_address(url, tmp_path / "key")


def test_key_file_is_private_and_has_one_key(tmp_path):
    file = tmp_path / "key"
    url = "https://farm.lab:8467/printers/"
    with pytest.raises(FarmError, match="--url needs --key-file"):
        read_address(url, None)
    with pytest.raises(FarmError, match="cannot be read"):
        read_address(url, file)
    file.write_text(KEY_TEXT + "\n")
    file.chmod(0o640)
    with pytest.raises(FarmError, match="`chmod 600"):
        read_address(url, file)
    file.chmod(0o600)
    address = read_address(url, file)
    assert (str(address), address.key) == ("https://farm.lab:8467/printers", KEY_TEXT)
    file.write_text("two\nlines")
    with pytest.raises(FarmError, match="one key and nothing else"):
        read_address(url, file)


def test_sessions_are_listed_with_their_kind_and_end(monkeypatch):
    [key] = Daemon(None).fetch_keys().keys
    open_session = key.model_copy(update={"id": "s1", "kind": KeyKind.SESSION})
    fields = {"revoked": "2026-11-20T10:30:00+00:00", "valid": False}
    ended_session = open_session.model_copy(update={"id": "s2", **fields})
    monkeypatch.setattr(
        Daemon,
        "fetch_keys",
        lambda _: api.Keys(
            now="2026-11-20T11:00:00+00:00", network=Daemon.network, keys=[key, open_session, ended_session]
        ),
    )
    rows = {line.split()[0]: line.split()[2:6] for line in run().stdout.splitlines()[2:]}
    assert rows["abcd2345"][0] == "key"
    assert rows["s1"][:3] == ["session", "look", "valid"]
    assert rows["s2"][:3] == ["session", "look", "ended"]
