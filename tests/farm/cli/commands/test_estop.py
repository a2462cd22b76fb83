"""`farm estop` for users without access to the agents: client and server of the socket."""

import io
import socket
import threading

import pytest

from drivers.safety import StopResult
from farm.cli import estop_socket
from farm.cli.commands import estop
from farm.errors import ErrorCode, FarmError, NotFoundError
from farm.paths import find_farm_paths


@pytest.fixture
def send_stop(tmp_path):
    """Return a function that requests a stop; a thread serves the request with the given `stop`."""
    path = tmp_path / "estop.sock"

    def send_request(stop, printers):
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(path))
            listener.listen()

            def serve():
                connection, _ = listener.accept()
                with (
                    connection,
                    connection.makefile("r", encoding="utf-8") as request_file,
                    connection.makefile("w") as answer_file,
                ):
                    estop_socket.serve_request(request_file, answer_file, stop)

            serve_thread = threading.Thread(target=serve)
            serve_thread.start()
            results = []
            try:
                estop_socket.request_stop(path, printers, results.append)
            finally:
                serve_thread.join()
            return results

    return send_request


def test_results_are_printed_as_they_arrive(send_stop):
    messages = [
        estop_socket.StopReport(printer="a", text="it cools"),
        estop_socket.StopReport(printer="a", text="off", seen_off=True),
    ]
    requests = []

    def stop(printers, report):
        requests.extend(printers)
        for report_item in messages:
            report(report_item)

    assert send_stop(stop, ["a"]) == messages
    assert requests == ["a"]


def test_error_of_the_server_is_an_error_of_the_client(send_stop):
    def stop(printers, report):
        raise NotFoundError("there is no printer z")

    with pytest.raises(FarmError, match="there is no printer z") as error:
        send_stop(stop, ["z"])
    assert error.value.code is ErrorCode.NO_SUCH_THING


@pytest.mark.parametrize(
    "invalid_data", [b"\xff\xfe\n", b"\n", b'{"printers": "all"}\n', b"[" * 100_000 + b"\n"]
)
def test_invalid_request_is_refused_and_stops_nothing(tmp_path, invalid_data):
    request_file, answer_file = io.TextIOWrapper(io.BytesIO(invalid_data), encoding="utf-8"), io.StringIO()
    estop_socket.serve_request(
        request_file, answer_file, lambda printers, report: pytest.fail(f"stopped {printers}")
    )
    assert '"code":"refused"' in answer_file.getvalue()


@pytest.mark.parametrize("invalid_data", [b"\xff\xfe\n", b"{}\n", b"\n"])
def test_invalid_answer_does_not_confirm_a_stop(tmp_path, invalid_data):
    path = tmp_path / "estop.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()

        def send_answer():
            connection, _ = listener.accept()
            with connection:
                connection.sendall(invalid_data)

        answer_thread = threading.Thread(target=send_answer)
        answer_thread.start()
        with pytest.raises(FarmError, match="switch the printers off by hand"):
            estop_socket.request_stop(path, [], lambda report: None)
        answer_thread.join()


def test_lost_connection_does_not_confirm_a_stop(tmp_path):
    path = tmp_path / "estop.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        closing_thread = threading.Thread(target=lambda: listener.accept()[0].close())
        closing_thread.start()
        with pytest.raises(FarmError, match="switch the printers off by hand"):
            estop_socket.request_stop(path, [], lambda report: None)
        closing_thread.join()
    with pytest.raises(FarmError, match="switch the printers off by hand"):
        estop_socket.request_stop(path, [], lambda report: None)


def test_farm_of_another_user_without_a_socket_is_reported(tmp_path, monkeypatch):
    (tmp_path / "farm.sock").touch()
    paths = find_farm_paths(tmp_path / "state", tmp_path / "farm.sock", None)
    monkeypatch.setattr(estop_socket.os, "geteuid", lambda: 4711)
    with pytest.raises(FarmError, match="belongs to another user and has no"):
        estop_socket.find_estop_socket(paths)
    (tmp_path / "estop.sock").touch()
    assert estop_socket.find_estop_socket(paths) == tmp_path / "estop.sock"


def test_root_with_a_state_folder_needs_no_socket(tmp_path, monkeypatch):
    (tmp_path / "estop.sock").touch()
    monkeypatch.setattr(estop_socket, "_find_owner", lambda path: 4711 if path.exists() else None)
    monkeypatch.setattr(estop_socket.os, "geteuid", lambda: 0)
    paths = find_farm_paths(tmp_path / "state", tmp_path / "farm.sock", None)
    assert estop_socket.find_estop_socket(paths) == tmp_path / "estop.sock"
    (tmp_path / "state" / "agents").mkdir(parents=True)
    assert estop_socket.find_estop_socket(paths) is None


def test_owner_of_a_farm_does_not_use_the_estop_socket(tmp_path):
    (tmp_path / "estop.sock").touch()
    paths = find_farm_paths(tmp_path / "state", tmp_path / "farm.sock", None)
    assert estop_socket.find_estop_socket(paths) is None
    assert (
        estop_socket.find_estop_socket(
            find_farm_paths(tmp_path / "state", tmp_path / "elsewhere" / "farm.sock", None)
        )
        is None
    )


class RecordedStream(io.StringIO):
    """Stream that records each write separately."""

    def __init__(self):
        super().__init__()
        self.writes = []

    def write(self, text):
        self.writes.append(text)
        return len(text)


def test_report_line_is_written_in_one_call(monkeypatch):
    stream = RecordedStream()
    monkeypatch.setattr(estop.sys, "stdout", stream)
    estop.print_report(estop_socket.StopReport(printer="a", text="ssh said\nthis and\r that"))
    assert stream.writes == ["a: ssh said this and that\n"]


class ObservedLock:
    """Lock that knows which thread holds it."""

    def __init__(self):
        self._lock, self.holder = threading.Lock(), None

    def __enter__(self):
        self._lock.acquire()
        self.holder = threading.get_ident()

    def __exit__(self, *_):
        self.holder = None
        self._lock.release()


def test_lines_of_several_printers_do_not_mix(tmp_path, monkeypatch):
    """Report under one lock, which is checked instead of provoking overlaps."""
    all_started = threading.Barrier(8)
    locks, results = [], []

    def make_lock():
        locks.append(ObservedLock())
        return locks[-1]

    def make_target(name):
        def stop(report_text):
            all_started.wait(10.0)
            for _ in range(20):
                report_text("it cools")
            return StopResult(name, 0.0, True, "off", is_still=True)

        return stop

    def report(item):
        results.append([lock.holder for lock in locks] == [threading.get_ident()])

    targets = {name: make_target(name) for name in "abcdefgh"}
    monkeypatch.setattr(estop, "find_targets", lambda paths: (targets, None))
    monkeypatch.setattr(estop, "Lock", make_lock)
    estop.stop_all(find_farm_paths(tmp_path, None, None), [], report)
    assert results == [True] * (8 * 21)


@pytest.mark.parametrize(
    ("seen_off", "still", "message"),
    [(False, True, "heaters not confirmed off: a"), (True, False, "standstill not confirmed: a")],
)
def test_unconfirmed_stop_is_an_error_with_the_name_of_the_printer(
    tmp_path, monkeypatch, seen_off, still, message
):
    targets = {"a": lambda report_text: StopResult("a", 0.0, seen_off, "hm", still)}
    monkeypatch.setattr(estop, "find_targets", lambda paths: (targets, None))
    results = []
    with pytest.raises(FarmError, match=message):
        estop.stop_all(find_farm_paths(tmp_path, None, None), [], results.append)
    assert [(item.seen_off, item.still) for item in results] == [(seen_off, still)]
