"""Hosts that are lost while the daemon restarts: their loss is not reported twice."""

import asyncio
from pathlib import Path

from drivers.host import HostState
from farm.agents import hosts
from farm.config import Fleet
from farm.paths import StateFolder
from farm.state import events as ev

PRINTER_MODEL = "ultimaker2_plus"


class StoppedClock:
    """Clock that the test sets."""

    scale, anchor_s, now_s = 1.0, 0.0, 1000.0

    def now(self) -> float:
        return self.now_s


class EventRecorder:
    """Listener that stores events."""

    def __init__(self) -> None:
        self.events: list[ev.AnyEvent] = []

    def handle(self, *events: ev.AnyEvent) -> None:
        self.events += events

    def warn(self, topic: str, text: str | None) -> None:
        raise AssertionError(text)


def test_restarted_daemon_reports_the_return_of_a_host_but_not_its_loss_again(tmp_path: Path, monkeypatch):
    monkeypatch.setenv("FARM_SSH", "false")
    fields = {"model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}", "host_command": "farm host"}
    rows = [{"name": f"of-{host}", "host": host, **fields} for host in ("pc-a", "pc-b")]
    fleet, clock, listener = Fleet.model_validate({"printers": rows}), StoppedClock(), EventRecorder()
    connections = hosts.Hosts(fleet, StateFolder(tmp_path), clock, listener)  # type: ignore[arg-type]

    async def restart() -> None:
        connections.start(lost_hosts={"pc-a"})
        await connections.close()

    asyncio.run(restart())
    clock.now_s += 60.0
    connections.watch()
    assert [(type(event), event.host) for event in listener.events] == [(ev.HostLost, "pc-b")]
    listener.events.clear()
    for record in connections.records:
        record.on_state(clock.now_s, HostState(pid=1))
    connections.watch()
    assert [(type(event), event.host) for event in listener.events] == [
        (ev.HostConnected, "pc-a"),
        (ev.HostConnected, "pc-b"),
    ]
