"""Starts of prints that the journal contains, by an agent in this process without a port."""

import hashlib
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.agent.loop import Agent
from drivers.emulator.launch import Command, control
from drivers.records import JOURNAL, Journal, StartFile

MODEL = "ultimaker2_plus"
GCODE = b"G28\n"


@pytest.fixture(autouse=True)
def _ready_link(monkeypatch: pytest.MonkeyPatch) -> None:
    """Report the link as ready without a board."""
    monkeypatch.setattr("drivers.agent.requests.describe_link", lambda *_: (m.LinkState.READY, None))


@pytest.fixture(autouse=True)
def _signal_handlers() -> Iterator[None]:
    """Restore the signal handlers that an agent replaces."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    signal.set_wakeup_fd(-1)
    for number, handler in handlers.items():
        signal.signal(number, handler)


def make_agent(folder: Path) -> Agent:
    agent = Agent(StartFile("a", MODEL, f"sim://{MODEL}"), folder)
    agent._board.state.bed_unknown_reason = None
    return agent


def make_request(folder: Path, print_id: str) -> m.StartPrint:
    file = folder / "p.gcode"
    file.write_bytes(GCODE)
    digest = hashlib.sha256(GCODE).hexdigest()
    filament = m.Filament.PARKED
    return m.StartPrint(
        id=0, print_id=print_id, gcode=str(file), sha256=digest, print_time_s=1.0, filament=filament
    )


def test_forgotten_print_is_not_started_a_second_time(tmp_path: Path):
    """Start nothing, because the part would be printed twice if the daemon has not stored the end."""
    journal = Journal(tmp_path / JOURNAL)
    for print_id in ("p-1", "p-2"):
        done_print = m.PrintSnapshot(print_id=print_id, phase=m.PrintPhase.DONE, ended_s=1.0)
        journal.write(1.0, print=done_print.model_dump(mode="json"), filament="parked")
    journal.write(2.0, print=None)
    agent = make_agent(tmp_path)
    for print_id in ("p-1", "p-2"):
        reply = agent._answer_request(make_request(tmp_path, print_id))
        assert reply.error is None
        assert reply.snapshot is not None and reply.snapshot.print is None
        assert agent._board.session is None
    assert agent._answer_request(make_request(tmp_path, "p-3")).error is None  # an unknown print is started
    assert agent._board.session is not None
    agent._request_handler.must_end = True
    agent.run()
    control(tmp_path / "emulator", Command.POWER_OFF)  # it outlives its agent
