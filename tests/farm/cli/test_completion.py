"""Completion of arguments in the shell."""

import os
import socket
import subprocess
import threading
from http.server import BaseHTTPRequestHandler
from socketserver import UnixStreamServer

import pytest
import typer

from farm.api import JobName, Names
from farm.cli import completion
from farm.model import JobState
from farms.real_farm import FARM_PROGRAM

NAMES = Names(
    printers=["um2-01", "um2-02", "um2x-01"],
    jobs=[
        JobName(id=3, name="bunny.stl", state=JobState.PRINTING, parts=["3/p01", "3/p02"]),
        JobName(id=12, name="dragon.stl", state=JobState.QUEUED, parts=[]),
    ],
)


class FakeDaemonHandler(BaseHTTPRequestHandler):
    def do_GET(self):
        body = NAMES.model_dump_json().encode() if self.path == "/names" else b"?"
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def daemon(tmp_path):
    """Serve the socket of a daemon that knows `NAMES`."""
    with UnixStreamServer(str(tmp_path / "farm.sock"), FakeDaemonHandler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield tmp_path / "farm.sock"
        server.shutdown()
        thread.join()


def complete_word(completer, incomplete, **params):
    context = typer.Context(typer.main.get_command(typer.Typer(callback=lambda: None)))
    context.params = params
    return [name for name, _ in completer(context, incomplete)]


@pytest.mark.parametrize(
    ("completer", "incomplete", "names"),
    [
        (completion.printers, "", NAMES.printers),
        (completion.printers, "um2-", ["um2-01", "um2-02"]),
        (completion.beds, "a", ["all"]),
        (completion.jobs, "1", ["12"]),
        (completion.parts, "p", ["p01", "p02"]),
        (completion.targets, "3", ["3", "3/p01", "3/p02"]),
        (completion.targets, "um2x", ["um2x-01"]),
    ],
)
def test_names_with_the_prefix_are_offered(daemon, completer, incomplete, names):
    assert complete_word(completer, incomplete, socket=str(daemon), job=3) == names


def test_completion_is_empty_and_silent_without_a_daemon(tmp_path, capfd):
    assert complete_word(completion.targets, "", socket=tmp_path / "farm.sock") == []
    with socket.socket(socket.AF_UNIX) as listener:  # a server that does not speak HTTP
        listener.bind(str(tmp_path / "farm.sock"))
        listener.listen()
        thread = threading.Thread(target=lambda: listener.accept()[0].close())
        thread.start()
        assert complete_word(completion.targets, "", socket=tmp_path / "farm.sock") == []
        thread.join()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("farm clear", ["cleared"]),
        ("farm cleared um2-", ["um2-01", "um2-02"]),
        ("farm reprint 3 p", ["p01", "p02"]),
        ("farm report ", ["3", "12"]),
    ],
)
def test_bash_completion_calls_the_command(daemon, line, names):
    arguments = {
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
        "_FARM_COMPLETE": "complete_bash",
    }
    result = subprocess.run(
        [FARM_PROGRAM],
        env={**os.environ, **arguments, "FARM_SOCKET": str(daemon)},
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert (result.stdout.split(), result.stderr) == (names, "")
