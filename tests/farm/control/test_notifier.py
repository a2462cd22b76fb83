"""Notifications through apprise, to a real HTTP server on this host."""

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from queue import SimpleQueue

import pytest
from pydantic import SecretStr

from books.make_books import apply_events, make_end_event, make_planned_books
from farm.config import Fleet
from farm.control.notifier import Notifier, delete_record
from farm.errors import FleetFileError
from farm.state import events as ev

pytest.importorskip("apprise")
pytestmark = pytest.mark.filterwarnings(
    "ignore:'imghdr' is deprecated:DeprecationWarning"
)  # raised by apprise
TIME_LIMIT_S = 60.0


@pytest.fixture
def server():
    """Start a server that stores posted bodies; yield them and its address."""
    posts = SimpleQueue()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            posts.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield posts, f"127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def make_printed_books():
    assigned_event = ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
    return apply_events(make_planned_books(plates=1), assigned_event, make_end_event("x"))[0]


def test_notice_is_sent_once_over_restarts(server, tmp_path, caplog):
    posts, address = server
    urls = [SecretStr(f"json://ann:secret@{address}/"), SecretStr("json://ann:secret@127.0.0.1:1/")]
    file = tmp_path / "told.json"
    notifier = Notifier(urls, "lab", file, 0.0)
    notifier.notify(make_printed_books(), 500.0)
    post = posts.get(timeout=TIME_LIMIT_S)
    assert post["title"] == "lab"
    assert post["message"].splitlines() == [
        "job 1 (bracket.stl) is printed: 1 part in 3 min",
        "all jobs have ended",
    ]
    notifier.notify(make_printed_books(), 510.0)
    restarted_notifier = Notifier(urls, "lab", file, 520.0)
    restarted_notifier.notify(make_printed_books(), 530.0)
    failed_event = make_end_event("y", "failed", at_s=600.0, fault="kill", reason="it was killed")
    assigned_event = ev.PlateAssigned(at_s=550.0, plate="1/02", printer="b", print_id="y")
    books, _ = apply_events(make_planned_books(plates=2), assigned_event, failed_event)
    restarted_notifier.notify(books, 700.0)
    assert posts.get(timeout=TIME_LIMIT_S)["message"] == "1/p02 failed on b: it was killed"
    assert posts.empty()
    assert "secret" not in caplog.text


def test_events_before_the_first_notice_are_not_sent(server, tmp_path):
    posts, address = server
    file = tmp_path / "told.json"
    Notifier([SecretStr(f"json://{address}/")], "lab", file, 300.0).notify(make_printed_books(), 500.0)
    delete_record(file)
    delete_record(file)
    assert not file.exists()
    late_notifier = Notifier([SecretStr(f"json://{address}/")], "lab", file, 150.0)
    late_notifier.notify(make_printed_books(), 500.0)
    assert posts.get(timeout=TIME_LIMIT_S)["title"] == "lab"
    assert posts.empty()


def test_unknown_address_is_refused_without_printing_it(tmp_path):
    with pytest.raises(FleetFileError, match="address 2") as error:
        Notifier(
            [SecretStr("json://localhost"), SecretStr("nonsense://secret")],
            "lab",
            tmp_path / "told.json",
            0.0,
        )
    assert "secret" not in str(error.value)


def test_addresses_are_never_shown():
    row = {"name": "a", "model": "m", "port": "/dev/a"}
    fleet = Fleet.model_validate({"fleet": {"notify": ["json://ann:secret@host"]}, "printers": [row]})
    assert "secret" not in repr(fleet) + fleet.model_dump_json()


def test_events_after_a_backward_clock_step_are_notified(server, tmp_path):
    posts, address = server
    file = tmp_path / "told.json"
    notifier = Notifier([SecretStr(f"json://{address}/")], "lab", file, 4000.0)
    notifier.on_clock_set(-3900.0)
    notifier.notify(make_printed_books(), 500.0)
    assert "is printed" in posts.get(timeout=TIME_LIMIT_S)["message"]
    file.write_text(json.dumps({"since_s": 4000.0, "told": {}}))
    Notifier([SecretStr(f"json://{address}/")], "lab", file, 100.0).notify(make_printed_books(), 500.0)
    assert "is printed" in posts.get(timeout=TIME_LIMIT_S)["message"]
