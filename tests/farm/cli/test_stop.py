"""`farm estop` of somebody who may not touch the agents: a button with two ends."""

import io
import socket
import threading

import pytest

from farm.cli import button
from farm.cli.button import Said
from farm.errors import ErrorCode, FarmError, NoSuchThing
from farm.paths import find_places


@pytest.fixture
def pressed(tmp_path):
    """Presses a button whose other end is a thread with this `stop`."""
    path = tmp_path / "estop.sock"

    def press(stop, printers):
        with socket.socket(socket.AF_UNIX) as listening:
            listening.bind(str(path))
            listening.listen()

            def serve():
                talk, _ = listening.accept()
                with talk, talk.makefile("r", encoding="utf-8") as asked, talk.makefile("w") as said:
                    button.answer(asked, said, stop)

            serving = threading.Thread(target=serve)
            serving.start()
            heard = []
            try:
                button.press(path, printers, heard.append)
            finally:
                serving.join()
            return heard

    return press


def test_what_came_of_it_is_said_as_it_comes(pressed):
    words = [Said(printer="a", text="it cools"), Said(printer="a", text="off", seen_off=True)]
    asked = []

    def stop(printers, say):
        asked.extend(printers)
        for word in words:
            say(word)

    assert pressed(stop, ["a"]) == words
    assert asked == ["a"]


def test_what_went_wrong_at_the_other_end_goes_wrong_here(pressed):
    def stop(printers, say):
        raise NoSuchThing("there is no printer z")

    with pytest.raises(FarmError, match="there is no printer z") as caught:
        pressed(stop, ["z"])
    assert caught.value.code is ErrorCode.NO_SUCH_THING


@pytest.mark.parametrize("rubbish", [b"\xff\xfe\n", b"\n", b'{"printers": "all"}\n', b"[" * 100_000 + b"\n"])
def test_what_is_no_wish_is_refused_and_stops_nothing(tmp_path, rubbish):
    asked, said = io.TextIOWrapper(io.BytesIO(rubbish), encoding="utf-8"), io.StringIO()
    button.answer(asked, said, lambda printers, say: pytest.fail(f"stopped {printers}"))
    assert '"code":"refused"' in said.getvalue()


@pytest.mark.parametrize("rubbish", [b"\xff\xfe\n", b"{}\n", b"\n"])
def test_an_end_that_answers_rubbish_is_no_printer_that_is_off(tmp_path, rubbish):
    path = tmp_path / "estop.sock"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()

        def answer():
            talk, _ = listening.accept()
            with talk:
                talk.sendall(rubbish)

        answering = threading.Thread(target=answer)
        answering.start()
        with pytest.raises(FarmError, match="switch the printers off by hand"):
            button.press(path, [], lambda said: None)
        answering.join()


def test_an_end_that_dies_is_no_printer_that_is_off(tmp_path):
    path = tmp_path / "estop.sock"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()
        dying = threading.Thread(target=lambda: listening.accept()[0].close())
        dying.start()
        with pytest.raises(FarmError, match="switch the printers off by hand"):
            button.press(path, [], lambda said: None)
        dying.join()
    with pytest.raises(FarmError, match="switch the printers off by hand"):
        button.press(path, [], lambda said: None)


def test_another_users_farm_without_a_button_is_not_taken_for_ones_own(tmp_path, monkeypatch):
    (tmp_path / "farm.sock").touch()
    places = find_places(tmp_path / "state", tmp_path / "farm.sock", None)
    monkeypatch.setattr(button.os, "geteuid", lambda: 4711)
    with pytest.raises(FarmError, match="another user's and has no"):
        button.way(places)
    (tmp_path / "estop.sock").touch()
    assert button.way(places) == tmp_path / "estop.sock"


def test_root_that_was_told_the_state_folder_needs_no_button(tmp_path, monkeypatch):
    (tmp_path / "estop.sock").touch()
    monkeypatch.setattr(button, "_owner", lambda path: 4711 if path.exists() else None)
    monkeypatch.setattr(button.os, "geteuid", lambda: 0)
    places = find_places(tmp_path / "state", tmp_path / "farm.sock", None)
    assert button.way(places) == tmp_path / "estop.sock"
    (tmp_path / "state" / "agents").mkdir(parents=True)
    assert button.way(places) is None


def test_the_owner_of_a_farm_needs_no_button(tmp_path):
    (tmp_path / "estop.sock").touch()
    places = find_places(tmp_path / "state", tmp_path / "farm.sock", None)
    assert button.way(places) is None
    assert button.way(find_places(tmp_path / "state", tmp_path / "elsewhere" / "farm.sock", None)) is None
